#include "drivers/scene/shade.h"

#include <algorithm>
#include <cmath>

namespace lcdm::scene {
namespace {

constexpr float kShadowReach = 45;     // metres towards the sun that are searched
constexpr float kShadowDistance = 70;  // from the eye; beyond it haze hides them
constexpr float kLift = 0.01F;         // shadow rays start so far off the surface

}  // namespace

ShadowCasters::ShadowCasters(const Snapshot& snapshot) {
  for (std::size_t i = 0; i < snapshot.count; ++i) {
    const Primitive& p = snapshot.storage[i];
    if (!p.casts_shadow) continue;
    indices[count] = static_cast<std::uint16_t>(i);
    x[count] = p.centre.x;
    y[count] = p.centre.y;
    z[count] = p.centre.z;
    bound[count++] = p.bound;
  }
}

std::size_t ShadowCasters::near_line(
    Vec3 from, Vec3 reach, float radius,
    std::span<std::uint16_t, Snapshot::kMaxPrimitives> chosen) const {
  // A loop without branches for the compiler to vectorise, then one that collects.
  std::array<std::int32_t, Snapshot::kMaxPrimitives> near;
  const float inverse = 1 / dot(reach, reach);
  for (std::size_t i = 0; i < count; ++i) {
    const Vec3 to{x[i] - from.x, y[i] - from.y, z[i] - from.z};
    const float along = std::min(std::max(dot(to, reach) * inverse, 0.0F), 1.0F);
    const Vec3 off = to - reach * along;
    const float limit = bound[i] + radius;
    near[i] = dot(off, off) < limit * limit ? 1 : 0;
  }
  std::size_t found = 0;
  for (std::size_t i = 0; i < count; ++i) {
    if (near[i] != 0) chosen[found++] = indices[i];
  }
  return found;
}

void Shader::shade(const RayBatch& rays, std::span<Vec3> colours) {
  group_by_hit(rays);
  // Things first, the sky last: it needs no light.
  Range things;
  for (const Group& group : std::span(groups_).first(group_count_)) {
    if (group.hit == kHitNothing) continue;
    const Range range{group.begin, group.begin + group.count};
    things.end = range.end;
    if (group.hit == kHitGround) {
      paint_ground(snapshot_, pixel_, range, surfaces_);
    } else {
      paint_primitive(snapshot_, snapshot_.storage[static_cast<std::size_t>(group.hit)], pixel_,
                      range, surfaces_);
    }
  }
  cast_shadows(things);
  light_surfaces(snapshot_, things, surfaces_);
  const auto count = static_cast<std::size_t>(rays.count);
  if (things.end < count) paint_sky(snapshot_, pixel_, {things.end, count}, surfaces_);
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t k = place_[i];
    colours[i] = {surfaces_.r[k], surfaces_.g[k], surfaces_.b[k]};
  }
}

// Copies the rays into surfaces_ so that those of one thing lie together, the sky's at the end.
void Shader::group_by_hit(const RayBatch& rays) {
  const auto count = static_cast<std::size_t>(rays.count);
  std::array<std::uint16_t, RayBatch::kCapacity> group_of;
  group_count_ = 0;
  std::size_t last = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const std::int32_t hit = rays.hit[i];
    if (group_count_ == 0 || groups_[last].hit != hit) {
      last = 0;
      while (last < group_count_ && groups_[last].hit != hit) ++last;
      if (last == group_count_) groups_[group_count_++] = {hit, 0, 0};
    }
    ++groups_[last].count;
    group_of[i] = static_cast<std::uint16_t>(last);
  }
  std::array<std::size_t, RayBatch::kCapacity> next;
  std::size_t begin = 0;
  for (const bool sky : {false, true}) {
    for (std::size_t k = 0; k < group_count_; ++k) {
      if ((groups_[k].hit == kHitNothing) != sky) continue;
      groups_[k].begin = next[k] = begin;
      begin += groups_[k].count;
    }
  }
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t k = next[group_of[i]]++;
    place_[i] = static_cast<std::uint16_t>(k);
    surfaces_.dx[k] = rays.dx[i];
    surfaces_.dy[k] = rays.dy[i];
    surfaces_.dz[k] = rays.dz[i];
    surfaces_.t[k] = rays.t[i];
  }
}

// Shadow rays of the surfaces that face the light. Those of a neighbourhood lie close together, so
// few primitives can stand between; where it spans near and far, each of the two gets its own
// group.
void Shader::cast_shadows(Range lit) {
  std::array<std::uint16_t, RayBatch::kCapacity> facing;
  std::size_t count = 0;
  float nearest = kFar;
  float farthest = 0;
  for (std::size_t i = lit.begin; i < lit.end; ++i) {
    if (surfaces_.direct[i] <= 0 || surfaces_.t[i] > kShadowDistance) continue;
    facing[count++] = static_cast<std::uint16_t>(i);
    nearest = std::min(nearest, surfaces_.t[i]);
    farthest = std::max(farthest, surfaces_.t[i]);
  }
  if (count == 0) return;
  const auto all = std::span(facing).first(count);
  if (farthest < 1.3F * nearest) return cast_group(all);
  const float split = std::sqrt(nearest * farthest);
  const auto middle = std::partition(all.begin(), all.end(),
                                     [&](std::uint16_t i) { return surfaces_.t[i] <= split; });
  const auto near = static_cast<std::size_t>(middle - all.begin());
  cast_group(all.first(near));
  if (near < all.size()) cast_group(all.subspan(near));
}

void Shader::cast_group(std::span<const std::uint16_t> group) {
  Vec3 low{kFar, kFar, kFar};
  Vec3 high{-kFar, -kFar, -kFar};
  for (const std::uint16_t i : group) {
    const Vec3 p{surfaces_.px[i], surfaces_.py[i], surfaces_.pz[i]};
    low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
    high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
  }
  const Vec3 centre = (low + high) * 0.5F;
  const Vec3 reach = snapshot_.indoor ? snapshot_.sun - centre : snapshot_.sun * kShadowReach;
  std::array<std::uint16_t, Snapshot::kMaxPrimitives> chosen;
  const std::size_t casters = casters_.near_line(centre, reach, length(high - low) * 0.5F, chosen);
  if (casters == 0) return;

  shadow_rays_.count = static_cast<int>(group.size());
  for (std::size_t k = 0; k < group.size(); ++k) {
    const std::uint16_t i = group[k];
    const Vec3 from = Vec3{surfaces_.px[i], surfaces_.py[i], surfaces_.pz[i]} +
                      Vec3{surfaces_.nx[i], surfaces_.ny[i], surfaces_.nz[i]} * kLift;
    const Vec3 way = snapshot_.indoor ? snapshot_.sun - from : snapshot_.sun * kShadowReach;
    shadow_rays_.set(static_cast<int>(k), from, way, 1);
  }
  trace(snapshot_.primitives(), std::span(chosen).first(casters), shadow_rays_);
  for (std::size_t k = 0; k < group.size(); ++k) {
    if (shadow_rays_.hit[k] != kHitNothing) surfaces_.direct[group[k]] = 0;
  }
}

}  // namespace lcdm::scene
