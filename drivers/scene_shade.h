// Colours of what rays hit: surface, light, shadow, haze, sky.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "drivers/scene_trace.h"

namespace lcdm::scene {

// What a snapshot's shadows need, prepared once per picture.
struct ShadowCasters {
  std::array<std::uint16_t, Snapshot::kMaxPrimitives> indices;
  int count = 0;

  explicit ShadowCasters(const Snapshot& snapshot);
};

// Colours the traced rays of one small neighbourhood; `pixel` is the angle one pixel covers.
class Shader {
 public:
  Shader(const Snapshot& snapshot, const ShadowCasters& casters, float pixel)
      : snapshot_(snapshot), casters_(casters), pixel_(pixel) {}

  // colours: one per ray.
  void shade(const RayBatch& rays, std::span<Vec3> colours);

 private:
  struct Surface {
    Vec3 position;
    Vec3 normal;
    Vec3 albedo;
    float direct;  // how much of the sun or lamp falls on it when nothing stands between
  };

  void find_surfaces(const RayBatch& rays);
  Surface surface_of(Vec3 position, Vec3 direction, float t, const Primitive& primitive) const;
  Surface ground_at(Vec3 position, Vec3 direction, float t) const;
  float direct_light(Vec3 position, Vec3 normal) const;
  void cast_shadows(const RayBatch& rays);
  void cast_group(std::span<const std::uint16_t> group);
  Vec3 lit(const Surface& surface) const;
  Vec3 sky(Vec3 direction) const;

  const Snapshot& snapshot_;
  const ShadowCasters& casters_;
  const float pixel_;
  std::array<Surface, RayBatch::kCapacity> surfaces_;
  RayBatch shadow_rays_;
};

}  // namespace lcdm::scene
