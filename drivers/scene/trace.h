// Rays against primitives, many rays at a time.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "drivers/scene/scene.h"

namespace lcdm::scene {

constexpr std::int32_t kHitNothing = -1;
constexpr std::int32_t kHitGround = 0x7FFF;
constexpr float kFar = 1e6F;

// A batch of rays, each point = origin + t * direction. Directions need not have unit length.
// Arrays of their own, so that one instruction serves many rays.
struct alignas(64) RayBatch {
  // An 18 x 18 tile, rounded up to whole vectors of 16.
  static constexpr int kCapacity = 336;
  using Lane = std::array<float, kCapacity>;

  Lane ox, oy, oz;                            // origins
  Lane dx, dy, dz;                            // directions
  Lane inverse_dd;                            // 1 / (direction . direction), set by trace
  Lane t;                                     // nearest hit so far; before: how far to look
  std::array<std::int32_t, kCapacity> hit{};  // what was hit: an index, or kHit...
  int count = 0;

  // Sets ray i to look as far as t_max and hit nothing yet.
  void set(int i, Vec3 origin, Vec3 direction, float t_max) {
    const auto k = static_cast<std::size_t>(i);
    ox[k] = origin.x;
    oy[k] = origin.y;
    oz[k] = origin.z;
    dx[k] = direction.x;
    dy[k] = direction.y;
    dz[k] = direction.z;
    t[k] = t_max;
    hit[k] = kHitNothing;
  }
  // Makes ray `to` what ray `from` is, its hit included.
  void copy(std::size_t from, std::size_t to) {
    for (Lane* lane : {&ox, &oy, &oz, &dx, &dy, &dz, &t}) (*lane)[to] = (*lane)[from];
    hit[to] = hit[from];
  }
};

// For every ray the nearest of the `chosen` primitives in front of t: updates t and hit. Hits
// closer than t = 1e-3 do not count, nor do surfaces seen from inside.
void trace(std::span<const Primitive> primitives, std::span<const std::uint16_t> chosen,
           RayBatch& rays);

// The plane y = 0 seen from above, up to t = `limit`.
void trace_ground(float limit, RayBatch& rays);

}  // namespace lcdm::scene
