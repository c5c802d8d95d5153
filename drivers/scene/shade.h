// Colours of what rays hit: sorts the hits into things, has them painted, casts shadows.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "drivers/scene/paint.h"
#include "drivers/scene/trace.h"

namespace lcdm::scene {

// The primitives that cast shadows, prepared once per picture.
struct ShadowCasters {
  using Lane = std::array<float, Snapshot::kMaxPrimitives>;

  std::array<std::uint16_t, Snapshot::kMaxPrimitives> indices;
  Lane x, y, z, bound;
  std::size_t count = 0;

  explicit ShadowCasters(const Snapshot& snapshot);
  // Those whose bounding balls come within `radius` of the line from `from` along `reach`.
  std::size_t near_line(Vec3 from, Vec3 reach, float radius,
                        std::span<std::uint16_t, Snapshot::kMaxPrimitives> chosen) const;
};

// Colours the traced rays of one small neighbourhood; `pixel` is the angle one pixel covers.
class Shader {
 public:
  Shader(const Snapshot& snapshot, const ShadowCasters& casters, float pixel)
      : snapshot_(snapshot), casters_(casters), pixel_(pixel) {}

  // colours: one per ray. All rays start at the snapshot's eye.
  void shade(const RayBatch& rays, std::span<Vec3> colours);

 private:
  struct Group {
    std::int32_t hit;
    std::size_t begin;  // of its range in surfaces_
    std::size_t count;
  };

  void group_by_hit(const RayBatch& rays);
  void cast_shadows(Range lit);
  void cast_group(std::span<const std::uint16_t> group);

  const Snapshot& snapshot_;
  const ShadowCasters& casters_;
  const float pixel_;
  std::array<Group, RayBatch::kCapacity> groups_;
  std::size_t group_count_ = 0;
  std::array<std::uint16_t, RayBatch::kCapacity> place_;  // of every ray in surfaces_
  Surfaces surfaces_;
  RayBatch shadow_rays_;
};

}  // namespace lcdm::scene
