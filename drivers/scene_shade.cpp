#include "drivers/scene_shade.h"

#include <algorithm>
#include <cmath>

#include "drivers/scene_textures.h"

namespace lcdm::scene {
namespace {

constexpr float kShadowReach = 45;     // metres towards the sun that are searched
constexpr float kShadowDistance = 70;  // from the eye; beyond it haze hides them
constexpr float kLift = 0.01F;         // shadow rays start so far off the surface

float ramp(float low, float high, float x) {
  const float t = std::clamp((x - low) / (high - low), 0.0F, 1.0F);
  return t * t * (3 - 2 * t);
}

// 1 where |x - middle| < half, its edges softened over the pixel's own width.
float band(float x, float middle, float half, float soft) {
  return 1 - ramp(half - soft, half + soft, std::abs(x - middle));
}

// 1 - e^-x, near enough.
float fade(float x) { return 1 - 1 / (1 + x * (1 + x * (0.5F + x * 0.1667F))); }

Vec3 to_local(const Primitive& p, Vec3 v) {
  return {p.cos_yaw * v.x - p.sin_yaw * v.z, v.y, p.sin_yaw * v.x + p.cos_yaw * v.z};
}
Vec3 to_world(const Primitive& p, Vec3 v) {
  return {p.cos_yaw * v.x + p.sin_yaw * v.z, v.y, p.cos_yaw * v.z - p.sin_yaw * v.x};
}

// The outward normal in the primitive's own axes.
Vec3 local_normal(const Primitive& p, Vec3 at) {
  switch (p.shape) {
    case Shape::kSphere:
      return at * (1 / p.radius);
    case Shape::kCapsule: {
      const float along = std::clamp(dot(at, p.half) / dot(p.half, p.half), -1.0F, 1.0F);
      return normalized(at - p.half * along);
    }
    case Shape::kHoop: {
      const float planar = std::max(1e-6F, std::hypot(at.x, at.y));
      const float inwards = 1 - p.half.x / planar;
      return normalized({at.x * inwards, at.y * inwards, at.z});
    }
    case Shape::kBox:
      break;
  }
  // The face whose plane the point is closest to.
  const Vec3 off{std::abs(at.x) - p.half.x, std::abs(at.y) - p.half.y, std::abs(at.z) - p.half.z};
  if (off.x >= off.y && off.x >= off.z) return {std::copysign(1.0F, at.x), 0, 0};
  if (off.y >= off.z) return {0, std::copysign(1.0F, at.y), 0};
  return {0, 0, std::copysign(1.0F, at.z)};
}

struct Coordinates {
  float u, v;
};

// The texture lies flat on the axis plane that the surface faces most, from a box's corner on.
Coordinates texture_at(const Primitive& p, Vec3 at, Vec3 normal) {
  const Vec3 from = p.shape == Shape::kBox ? at + p.half : at + p.centre;
  const Vec3 facing{std::abs(normal.x), std::abs(normal.y), std::abs(normal.z)};
  if (facing.x >= facing.y && facing.x >= facing.z) return {from.z, from.y};
  if (facing.y >= facing.z) return {from.x, from.z};
  return {from.x, from.y};
}

Vec3 coloured(Vec3 dark, Vec3 light, const TextureSample& sample) {
  return mix(dark, light, sample.mix) * sample.bright;
}

}  // namespace

ShadowCasters::ShadowCasters(const Snapshot& snapshot) {
  for (std::size_t i = 0; i < snapshot.count; ++i) {
    if (!snapshot.storage[i].casts_shadow) continue;
    indices[static_cast<std::size_t>(count++)] = static_cast<std::uint16_t>(i);
  }
}

void Shader::shade(const RayBatch& rays, std::span<Vec3> colours) {
  find_surfaces(rays);
  cast_shadows(rays);
  for (std::size_t i = 0; i < static_cast<std::size_t>(rays.count); ++i) {
    if (rays.hit[i] == kHitNothing) {
      colours[i] = sky({rays.dx[i], rays.dy[i], rays.dz[i]});
      continue;
    }
    const float far = rays.t[i] * snapshot_.haze;
    colours[i] = mix(lit(surfaces_[i]), snapshot_.haze_colour, fade(far * far));
  }
}

void Shader::find_surfaces(const RayBatch& rays) {
  for (std::size_t i = 0; i < static_cast<std::size_t>(rays.count); ++i) {
    if (rays.hit[i] == kHitNothing) continue;
    const Vec3 direction{rays.dx[i], rays.dy[i], rays.dz[i]};
    const Vec3 position = Vec3{rays.ox[i], rays.oy[i], rays.oz[i]} + direction * rays.t[i];
    Surface& surface = surfaces_[i];
    surface = rays.hit[i] == kHitGround
                  ? ground_at(position, direction, rays.t[i])
                  : surface_of(position, direction, rays.t[i],
                               snapshot_.storage[static_cast<std::size_t>(rays.hit[i])]);
    surface.direct = direct_light(surface.position, surface.normal);
  }
}

Shader::Surface Shader::surface_of(Vec3 position, Vec3 direction, float t,
                                   const Primitive& primitive) const {
  const Vec3 at = to_local(primitive, position - primitive.centre);
  const Vec3 normal = local_normal(primitive, at);
  const Coordinates c = texture_at(primitive, at, normal);
  const Vec3 world_normal = to_world(primitive, normal);
  // A pixel covers more of a surface seen at a slant; the mean of both directions decides.
  const float slant = std::max(0.1F, std::abs(dot(direction, world_normal)));
  const float footprint = t * pixel_ / std::sqrt(slant) * primitive.scale;
  const TextureSample sample =
      textures().sample(primitive.texture, c.u * primitive.scale, c.v * primitive.scale, footprint);
  return {position, world_normal, coloured(primitive.dark, primitive.light, sample), 0};
}

Shader::Surface Shader::ground_at(Vec3 position, Vec3 direction, float t) const {
  const Vec3 up{0, -1, 0};
  const float across = t * pixel_;
  const float footprint = across / std::sqrt(std::max(0.02F, std::abs(direction.y)));
  const TextureSet& set = textures();
  const auto texture = [&](Texture which, float scale) {
    return set.sample(which, position.x * scale, position.z * scale, footprint * scale);
  };
  if (snapshot_.ground == Ground::kFloor) {
    return {position, up,
            coloured(snapshot_.ground_dark, snapshot_.ground_light, texture(snapshot_.floor, 1)),
            0};
  }

  const float row = std::clamp(position.z - Snapshot::kLineBegin, 0.0F,
                               static_cast<float>(Snapshot::kLineCount) - 1.001F);
  const auto index = static_cast<std::size_t>(row);
  const float part = row - static_cast<float>(index);
  const float line = snapshot_.centre_line[index] +
                     (snapshot_.centre_line[index + 1] - snapshot_.centre_line[index]) * part;
  const float aside = position.x - line;
  const float off = std::abs(aside);
  const bool street = snapshot_.ground == Ground::kStreet;
  const float edge = street ? 8.6F : 3.2F;
  if (off > edge + 0.6F) {
    // Two sizes of the same pattern: blades near by, meadows far off.
    const float meadow = texture(Texture::kGrass, 0.0625F).mix;
    const Vec3 near =
        coloured(snapshot_.ground_dark, snapshot_.ground_light, texture(Texture::kGrass, 1));
    return {position, up, near * (0.72F + 0.56F * meadow), 0};
  }
  if (!street) {
    const TextureSample sand = texture(Texture::kConcrete, 1);
    const TextureSample grass = texture(Texture::kGrass, 1);
    const Vec3 way = coloured({0.5F, 0.42F, 0.32F}, {0.8F, 0.72F, 0.58F}, sand);
    const Vec3 green = coloured(snapshot_.ground_dark, snapshot_.ground_light, grass);
    return {position, up, mix(way, green, ramp(edge - 0.3F, edge + 0.3F, off + grass.mix - 0.5F)),
            0};
  }
  if (off > 5.4F) {
    const TextureSample slab = texture(Texture::kTiles, 0.5F);
    const Vec3 paving = coloured({0.42F, 0.41F, 0.4F}, {0.72F, 0.7F, 0.66F}, slab);
    const Vec3 green =
        coloured(snapshot_.ground_dark, snapshot_.ground_light, texture(Texture::kGrass, 1));
    return {position, up, mix(paving, green, ramp(edge - 0.1F, edge + 0.1F, off)), 0};
  }
  Vec3 colour = coloured({0.2F, 0.2F, 0.21F}, {0.42F, 0.42F, 0.42F}, texture(Texture::kAsphalt, 1));
  const float soft = std::max(0.015F, across);
  const float dash = position.z * 0.125F - std::floor(position.z * 0.125F);
  const float dashes = band(dash, 0.3F, 0.25F, soft * 0.125F) * band(aside, 0, 0.07F, soft);
  const float parking = band(off, 3.25F, 0.05F, soft);
  const float paint = std::min(1.0F, dashes + parking) * std::min(1.0F, 0.07F / soft);
  colour = mix(colour, {0.85F, 0.84F, 0.8F}, 0.85F * paint);
  const float kerb = band(off, 5.3F, 0.1F, soft);
  return {position, up, mix(colour, {0.66F, 0.65F, 0.62F}, kerb), 0};
}

float Shader::direct_light(Vec3 position, Vec3 normal) const {
  if (!snapshot_.indoor) return std::max(0.0F, dot(normal, snapshot_.sun));
  const Vec3 to_lamp = snapshot_.sun - position;
  const float distance2 = dot(to_lamp, to_lamp);
  const float facing = dot(normal, to_lamp) / std::sqrt(distance2);
  return std::max(0.0F, facing) * 1.5F / (0.9F + 0.22F * distance2);
}

// Shadow rays of the surfaces that face the light. Those of a neighbourhood lie close together, so
// few primitives can stand between; where it spans near and far, each of the two gets its own
// group.
void Shader::cast_shadows(const RayBatch& rays) {
  std::array<std::uint16_t, RayBatch::kCapacity> facing;
  int count = 0;
  float nearest = kFar;
  float farthest = 0;
  for (int i = 0; i < rays.count; ++i) {
    const auto k = static_cast<std::size_t>(i);
    if (rays.hit[k] == kHitNothing || rays.t[k] > kShadowDistance) continue;
    if (surfaces_[k].direct <= 0) continue;
    facing[static_cast<std::size_t>(count++)] = static_cast<std::uint16_t>(i);
    nearest = std::min(nearest, rays.t[k]);
    farthest = std::max(farthest, rays.t[k]);
  }
  if (count == 0) return;
  const auto all = std::span(facing).first(static_cast<std::size_t>(count));
  const float split = std::sqrt(nearest * farthest);
  const auto middle =
      std::partition(all.begin(), all.end(), [&](std::uint16_t i) { return rays.t[i] <= split; });
  const auto near = static_cast<std::size_t>(middle - all.begin());
  if (farthest < 1.3F * nearest || near == 0 || near == all.size()) return cast_group(all);
  cast_group(all.first(near));
  cast_group(all.subspan(near));
}

void Shader::cast_group(std::span<const std::uint16_t> group) {
  Vec3 low{kFar, kFar, kFar};
  Vec3 high{-kFar, -kFar, -kFar};
  for (const std::uint16_t i : group) {
    const Vec3 p = surfaces_[i].position;
    low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
    high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
  }
  const Vec3 centre = (low + high) * 0.5F;
  const float radius = length(high - low) * 0.5F;
  const Vec3 reach = snapshot_.indoor ? snapshot_.sun - centre : snapshot_.sun * kShadowReach;
  const float inverse = 1 / dot(reach, reach);

  std::array<std::uint16_t, Snapshot::kMaxPrimitives> chosen;
  std::size_t casters = 0;
  for (const std::uint16_t i :
       std::span(casters_.indices).first(static_cast<std::size_t>(casters_.count))) {
    const Primitive& p = snapshot_.storage[i];
    const Vec3 to = p.centre - centre;
    const Vec3 off = to - reach * std::clamp(dot(to, reach) * inverse, 0.0F, 1.0F);
    const float limit = p.bound + radius;
    if (dot(off, off) < limit * limit) chosen[casters++] = i;
  }
  if (casters == 0) return;

  shadow_rays_.count = static_cast<int>(group.size());
  for (std::size_t k = 0; k < group.size(); ++k) {
    const Surface& surface = surfaces_[group[k]];
    const Vec3 from = surface.position + surface.normal * kLift;
    const Vec3 way = snapshot_.indoor ? snapshot_.sun - from : snapshot_.sun * kShadowReach;
    shadow_rays_.set(static_cast<int>(k), from, way, 1);
  }
  trace(snapshot_.primitives(), std::span(chosen).first(casters), shadow_rays_);
  for (std::size_t k = 0; k < group.size(); ++k) {
    if (shadow_rays_.hit[k] != kHitNothing) surfaces_[group[k]].direct = 0;
  }
}

Vec3 Shader::lit(const Surface& surface) const {
  const Vec3 n = surface.normal;
  // Light from the sky or ceiling, and a little back from the ground.
  Vec3 light =
      snapshot_.sky_colour * (0.78F - 0.22F * n.y) + snapshot_.ground_light * (0.1F * (1 + n.y));
  // Less of it gets into corners.
  const float height = -surface.position.y;
  float open = 1;
  if (snapshot_.indoor) {
    const Vec3 room = snapshot_.room;
    const float wall =
        std::min(room.x - std::abs(surface.position.x), room.z - std::abs(surface.position.z));
    const bool upright = std::abs(n.y) < 0.5F;
    const float corner = upright ? std::min(height, room.y - height) : wall;
    open = 0.72F + 0.28F * ramp(-0.05F, 0.6F, corner);
  } else if (n.y > -0.9F) {
    open = 0.7F + 0.3F * ramp(-0.1F, 0.7F, height);
  }
  light = light * open + snapshot_.sun_colour * surface.direct;
  return surface.albedo * light;
}

Vec3 Shader::sky(Vec3 direction) const {
  const Vec3 d = normalized(direction);
  const float up = std::max(0.0F, -d.y);
  const Vec3 zenith{0.3F, 0.5F, 0.82F};
  Vec3 colour = mix(snapshot_.haze_colour, zenith, ramp(-0.05F, 0.55F, up));
  // Clouds on a plane far above, thinning out towards the horizon.
  const TextureSet& set = textures();
  if (up > 0.02F) {
    const float per_height = 1 / (up + 0.12F);
    const TextureSample cloud = set.sample(Texture::kPlaster, d.x * per_height + 0.3F,
                                           d.z * per_height, pixel_ * per_height * per_height);
    colour = mix(colour, {0.97F, 0.96F, 0.95F},
                 0.85F * ramp(0.48F, 0.8F, cloud.mix) * ramp(0.02F, 0.2F, up));
  }
  const float glow = std::max(0.0F, dot(d, snapshot_.sun));
  const float glow4 = glow * glow * glow * glow;
  colour = colour + snapshot_.sun_colour * (0.35F * glow4 * glow4 * glow4);
  // Hills along the horizon.
  const float turn = d.x / (std::abs(d.x) + std::abs(d.z));
  const float around = d.z < 0 ? 2 - turn : turn;
  const float ridge = 0.015F + 0.09F * set.sample(Texture::kPlaster, around, 0.5F, 0.02F).mix;
  const Vec3 hills = mix(snapshot_.haze_colour, {0.42F, 0.52F, 0.56F}, 0.45F);
  return mix(hills, colour, ramp(ridge - pixel_, ridge + pixel_, up));
}

}  // namespace lcdm::scene
