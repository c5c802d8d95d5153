// The arithmetic of shading, many points at a time: surfaces, ground, light, sky.
#pragma once

#include <array>
#include <cstddef>

#include "drivers/scene/scene.h"
#include "drivers/scene/trace.h"

namespace lcdm::scene {

// Points that rays hit, points of one thing lying together. Rays start at the snapshot's eye.
struct alignas(64) Surfaces {
  // Work goes on in whole vectors, past the end of a range: what lies there is written anew by the
  // next step, or is room to spare.
  static constexpr std::size_t kCapacity = RayBatch::kCapacity + 16;
  using Lane = std::array<float, kCapacity>;

  Lane dx{}, dy{}, dz{};  // the ray's direction
  Lane t{};               // where on the ray
  Lane px{}, py{}, pz{};  // the point
  Lane nx{}, ny{}, nz{};  // its outward normal
  Lane r{}, g{}, b{};     // first the surface's colour, then that of the light coming from it
  Lane direct{};          // how much of the sun or lamp falls on it
};

// A range of points of Surfaces.
struct Range {
  std::size_t begin = 0;
  std::size_t end = 0;
};

// From dx...t to px...direct (direct as if nothing stood in the light's way). `pixel`: the angle a
// pixel covers.
void paint_primitive(const Snapshot& snapshot, const Primitive& primitive, float pixel, Range range,
                     Surfaces& surfaces);
void paint_ground(const Snapshot& snapshot, float pixel, Range range, Surfaces& surfaces);

// Turns surface colours into what the eye sees: light, shadow (direct = 0), haze.
void light_surfaces(const Snapshot& snapshot, Range range, Surfaces& surfaces);

// The sky along dx, dy, dz.
void paint_sky(const Snapshot& snapshot, float pixel, Range range, Surfaces& surfaces);

}  // namespace lcdm::scene
