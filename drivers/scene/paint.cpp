#include "drivers/scene/paint.h"

#include "drivers/scene/textures.h"

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "drivers/scene/paint.cpp"
#include "firmware/base/simd.h"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>
#include "drivers/scene/simd-inl.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace lcdm::scene {
namespace HWY_NAMESPACE {

using Integers = hn::Vec<hn::RebindToSigned<Tag>>;
using Words = hn::Vec<hn::RebindToUnsigned<Tag>>;
constexpr hn::RebindToUnsigned<Tag> kWordTag;

HWY_INLINE Integers integer(std::int32_t value) { return hn::Set(kIndexTag, value); }
HWY_INLINE Words word(std::uint32_t value) { return hn::Set(kWordTag, value); }
HWY_INLINE Floats clamp01(Floats x) { return hn::Min(hn::Max(x, number(0)), number(1)); }
HWY_INLINE Floats choose(Mask mask, Floats yes, Floats no) { return hn::IfThenElse(mask, yes, no); }
HWY_INLINE Vectors choose(Mask mask, const Vectors& yes, const Vectors& no) {
  return {choose(mask, yes.x, no.x), choose(mask, yes.y, no.y), choose(mask, yes.z, no.z)};
}
HWY_INLINE Vectors mixed(const Vectors& a, const Vectors& b, Floats t) {
  return {a.x + (b.x - a.x) * t, a.y + (b.y - a.y) * t, a.z + (b.z - a.z) * t};
}
HWY_INLINE Vectors scaled(const Vectors& a, Floats s) { return {a.x * s, a.y * s, a.z * s}; }
HWY_INLINE Vectors sum(const Vectors& a, const Vectors& b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
HWY_INLINE Vectors product(const Vectors& a, const Vectors& b) {
  return {a.x * b.x, a.y * b.y, a.z * b.z};
}
HWY_INLINE Vectors unit(const Vectors& a) {
  return scaled(a, number(1) / hn::Sqrt(hn::Max(inner(a, a), number(1e-20F))));
}
// 0 below `low`, 1 above `high`, smooth between.
HWY_INLINE Floats ramp(Floats low, Floats high, Floats x) {
  const Floats t = clamp01((x - low) / (high - low));
  return t * t * (number(3) - number(2) * t);
}
HWY_INLINE Floats ramp(float low, float high, Floats x) {
  return ramp(number(low), number(high), x);
}
// 1 where |x - middle| < half, its edges softened over `soft`.
HWY_INLINE Floats band(Floats x, float middle, float half, Floats soft) {
  const Floats off = hn::Abs(x - number(middle));
  return number(1) - ramp(number(half) - soft, number(half) + soft, off);
}

// ---- textures -----------------------------------------------------------------------------------

struct Samples {
  Floats mix, bright;
};

// a + (b - a) * weight / 256 in both lanes of each word (see TextureSet::Texel).
HWY_INLINE Words blend(Words a, Words b, Words weight) {
  const Words both = a * (word(256) - weight) + b * weight;
  return hn::And(hn::ShiftRight<8>(both), word(0x00FF00FFU));
}

// One bilinear sample of the level that begins at texel `base` and is `side` wide; x and y in
// 256ths of a texel. Whatever they are, no texel outside the level is read.
HWY_INLINE Words bilinear(const std::int32_t* texels, Integers base, Integers side, Integers x,
                          Integers y) {
  const Integers mask = side - integer(1);
  const Integers x0 = hn::And(hn::ShiftRight<8>(x), mask);
  const Integers x1 = hn::And(x0 + integer(1), mask);
  const Integers y0 = hn::And(hn::ShiftRight<8>(y), mask);
  const Integers y1 = hn::And(y0 + integer(1), mask);
  const Integers row0 = base + y0 * side;
  const Integers row1 = base + y1 * side;
  const auto fetch = [&](Integers at) {
    return hn::BitCast(kWordTag, hn::GatherIndex(kIndexTag, texels, at));
  };
  const Words fx = hn::BitCast(kWordTag, hn::And(x, integer(255)));
  const Words fy = hn::BitCast(kWordTag, hn::And(y, integer(255)));
  return blend(blend(fetch(row0 + x0), fetch(row0 + x1), fx),
               blend(fetch(row1 + x0), fetch(row1 + x1), fx), fy);
}

// log2 of positive numbers, to about 0.09: enough to choose a mip level.
HWY_INLINE Floats rough_log2(Floats x) {
  const Floats bits = hn::ConvertTo(kTag, hn::BitCast(kIndexTag, x));
  return bits * number(1.0F / 8388608.0F) - number(126.96F);
}

// The texture at (u, v) metres on the surface, where a pixel covers `footprint` metres; trilinear.
HWY_INLINE Samples sample(Texture texture, Floats u, Floats v, Floats footprint) {
  static_assert(TextureSet::kSide == 256 && TextureSet::kLevels == 9);
  const std::int32_t* texels = textures().tile(texture);
  const Floats tiles = number(TextureSet::tiles_per_metre(texture));
  const Floats level =
      hn::Min(hn::Max(rough_log2(footprint * tiles * number(256)), number(0)), number(8));
  // Bounded as integers: comparisons would let a NaN through.
  const Integers fine = hn::Min(hn::Max(hn::ConvertTo(kIndexTag, level), integer(0)), integer(7));
  const Floats beyond = level - hn::ConvertTo(kTag, fine);
  const Words between =
      hn::BitCast(kWordTag, hn::And(hn::ConvertTo(kIndexTag, beyond * number(256)), integer(511)));
  // 2^(8 - fine), as a float by its exponent.
  const Floats wide = hn::BitCast(kTag, hn::ShiftLeft<23>(integer(127 + 8) - fine));
  const Integers side = hn::ConvertTo(kIndexTag, wide);
  // Texels of the levels before, exact in a float.
  const Integers base =
      hn::ConvertTo(kIndexTag, (number(4 * 256 * 256) - number(4) * wide * wide) / number(3));
  const Floats scale = tiles * wide * number(256);
  const Integers x = hn::ConvertTo(kIndexTag, u * scale);
  const Integers y = hn::ConvertTo(kIndexTag, v * scale);
  const Integers half = integer(128);  // values lie at texel centres
  const Words near = bilinear(texels, base, side, x - half, y - half);
  const Words far = bilinear(texels, base + side * side, hn::ShiftRight<1>(side),
                             hn::ShiftRight<1>(x) - half, hn::ShiftRight<1>(y) - half);
  const Integers both = hn::BitCast(kIndexTag, blend(near, far, between));
  return {hn::ConvertTo(kTag, hn::And(both, integer(255))) * number(1.0F / 255),
          hn::ConvertTo(kTag, hn::ShiftRight<16>(both)) * number(1.0F / 128)};
}

HWY_INLINE Vectors coloured(Vec3 dark, Vec3 light, const Samples& s) {
  return scaled(mixed(numbers(dark), numbers(light), s.mix), s.bright);
}

// ---- surfaces -----------------------------------------------------------------------------------

HWY_INLINE Vectors load(const Surfaces::Lane& x, const Surfaces::Lane& y, const Surfaces::Lane& z,
                        std::size_t i) {
  return {hn::LoadU(kTag, &x[i]), hn::LoadU(kTag, &y[i]), hn::LoadU(kTag, &z[i])};
}
HWY_INLINE void store(const Vectors& v, std::size_t i, Surfaces::Lane& x, Surfaces::Lane& y,
                      Surfaces::Lane& z) {
  hn::StoreU(v.x, kTag, &x[i]);
  hn::StoreU(v.y, kTag, &y[i]);
  hn::StoreU(v.z, kTag, &z[i]);
}

// How much of the light falls on a point when nothing stands between.
HWY_INLINE Floats direct_light(const Snapshot& snapshot, const Vectors& at, const Vectors& normal) {
  const Floats zero = number(0);
  const Vectors sun = numbers(snapshot.sun);
  if (!snapshot.indoor) return hn::Max(zero, inner(normal, sun));
  const Vectors to_lamp{sun.x - at.x, sun.y - at.y, sun.z - at.z};
  const Floats distance2 = hn::Max(inner(to_lamp, to_lamp), number(1e-6F));
  const Floats facing = inner(normal, to_lamp) / hn::Sqrt(distance2);
  return hn::Max(zero, facing) * number(1.5F) / (number(0.9F) + number(0.22F) * distance2);
}

HWY_INLINE void store_surface(const Snapshot& snapshot, const Vectors& at, const Vectors& normal,
                              const Vectors& colour, std::size_t i, Surfaces& s) {
  store(at, i, s.px, s.py, s.pz);
  store(normal, i, s.nx, s.ny, s.nz);
  store(colour, i, s.r, s.g, s.b);
  hn::StoreU(direct_light(snapshot, at, normal), kTag, &s.direct[i]);
}

// The outward normal at a point, both in the primitive's own axes.
HWY_INLINE Vectors local_normal(const Primitive& p, const Vectors& at) {
  const Floats zero = number(0);
  const Floats one = number(1);
  switch (p.shape) {
    case Shape::kSphere:
      return scaled(at, number(1 / p.radius));
    case Shape::kCapsule: {
      const Vectors axis = numbers(p.half);
      const Floats along_axis =
          hn::Min(hn::Max(inner(at, axis) * number(1 / dot(p.half, p.half)), number(-1)), one);
      return unit(along(at, axis, hn::Neg(along_axis)));
    }
    case Shape::kHoop: {
      const Floats planar = hn::Max(hn::Sqrt(at.x * at.x + at.y * at.y), number(1e-6F));
      const Floats outwards = one - number(p.half.x) / planar;
      return unit({at.x * outwards, at.y * outwards, at.z});
    }
    case Shape::kBox:
      break;
  }
  // The face whose plane the point is closest to.
  const Floats x = hn::Abs(at.x) - number(p.half.x);
  const Floats y = hn::Abs(at.y) - number(p.half.y);
  const Floats z = hn::Abs(at.z) - number(p.half.z);
  const Mask on_x = hn::And(hn::Ge(x, y), hn::Ge(x, z));
  const Mask on_y = hn::AndNot(on_x, hn::Ge(y, z));
  const Mask on_z = hn::Not(hn::Or(on_x, on_y));
  return {choose(on_x, hn::CopySign(one, at.x), zero), choose(on_y, hn::CopySign(one, at.y), zero),
          choose(on_z, hn::CopySign(one, at.z), zero)};
}

struct Coordinates {
  Floats u, v;
};

// The texture lies flat on the axis plane that the surface faces most, from a box's corner on.
HWY_INLINE Coordinates texture_at(const Primitive& p, const Vectors& at, const Vectors& normal) {
  const Vectors from = sum(at, numbers(p.shape == Shape::kBox ? p.half : p.centre));
  const Floats x = hn::Abs(normal.x);
  const Floats y = hn::Abs(normal.y);
  const Floats z = hn::Abs(normal.z);
  const Mask on_x = hn::And(hn::Ge(x, y), hn::Ge(x, z));
  const Mask on_y = hn::AndNot(on_x, hn::Ge(y, z));
  return {choose(on_x, from.z, from.x), choose(on_y, from.z, from.y)};
}

void primitive_kernel(const Snapshot& snapshot, const Primitive& p, float pixel, Range range,
                      Surfaces& s) {
  const Vectors eye = numbers(snapshot.eye);
  const Vectors centre = numbers(p.centre);
  const Floats scale = number(p.scale);
  for (std::size_t i = range.begin; i < range.end; i += hn::Lanes(kTag)) {
    const Vectors d = load(s.dx, s.dy, s.dz, i);
    const Floats t = hn::LoadU(kTag, &s.t[i]);
    const Vectors point = along(eye, d, t);
    const Vectors at = into_local(p, {point.x - centre.x, point.y - centre.y, point.z - centre.z});
    const Vectors normal = local_normal(p, at);
    const Coordinates c = texture_at(p, at, normal);
    const Vectors world_normal = out_of_local(p, normal);
    // A pixel covers more of a surface seen at a slant; the mean of both directions decides.
    const Floats slant = hn::Max(number(0.1F), hn::Abs(inner(d, world_normal)));
    const Floats footprint = t * number(pixel * p.scale) / hn::Sqrt(slant);
    const Samples samples = sample(p.texture, c.u * scale, c.v * scale, footprint);
    store_surface(snapshot, point, world_normal, coloured(p.dark, p.light, samples), i, s);
  }
}

// ---- the ground ---------------------------------------------------------------------------------

// A patch of ground and how finely it is seen.
struct Patch {
  Floats x, z;
  Floats across;     // metres that a pixel covers from left to right
  Floats footprint;  // and on the whole
};

HWY_INLINE Samples ground_texture(Texture texture, const Patch& patch, float scale) {
  const Floats s = number(scale);
  return sample(texture, patch.x * s, patch.z * s, patch.footprint * s);
}

HWY_INLINE Vectors grass(const Snapshot& snapshot, const Patch& patch) {
  return coloured(snapshot.ground_dark, snapshot.ground_light,
                  ground_texture(Texture::kGrass, patch, 1));
}

// Two sizes of the same pattern: blades near by, meadows far off.
HWY_INLINE Vectors meadow(const Snapshot& snapshot, const Patch& patch) {
  const Floats far = ground_texture(Texture::kGrass, patch, 0.0625F).mix;
  return scaled(grass(snapshot, patch), number(0.72F) + number(0.56F) * far);
}

HWY_INLINE Vectors sandy_way(const Snapshot& snapshot, const Patch& patch, Floats off) {
  const Vectors way = coloured({0.5F, 0.42F, 0.32F}, {0.8F, 0.72F, 0.58F},
                               ground_texture(Texture::kConcrete, patch, 1));
  const Samples blades = ground_texture(Texture::kGrass, patch, 1);
  const Vectors green = coloured(snapshot.ground_dark, snapshot.ground_light, blades);
  return mixed(way, green, ramp(2.9F, 3.5F, off + blades.mix - number(0.5F)));
}

HWY_INLINE Vectors pavement(const Snapshot& snapshot, const Patch& patch, Floats off) {
  const Vectors paving = coloured({0.42F, 0.41F, 0.4F}, {0.72F, 0.7F, 0.66F},
                                  ground_texture(Texture::kTiles, patch, 0.5F));
  return mixed(paving, grass(snapshot, patch), ramp(8.5F, 8.7F, off));
}

// Asphalt, a dashed line in the middle, a line before each parking lane, kerbs.
HWY_INLINE Vectors road(const Patch& patch, Floats aside, Floats off) {
  const Vectors asphalt = coloured({0.2F, 0.2F, 0.21F}, {0.42F, 0.42F, 0.42F},
                                   ground_texture(Texture::kAsphalt, patch, 1));
  const Floats soft = hn::Max(number(0.015F), patch.across);
  const Floats eighth = patch.z * number(0.125F);
  const Floats dash = eighth - hn::Floor(eighth);
  const Floats dashes =
      band(dash, 0.3F, 0.25F, soft * number(0.125F)) * band(aside, 0, 0.07F, soft);
  const Floats thin = hn::Min(number(1), number(0.07F) / soft);  // lines under a pixel fade
  const Floats paint = clamp01(dashes + band(off, 3.25F, 0.05F, soft)) * thin;
  const Vectors lines = mixed(asphalt, numbers({0.85F, 0.84F, 0.8F}), number(0.85F) * paint);
  return mixed(lines, numbers({0.66F, 0.65F, 0.62F}), band(off, 5.3F, 0.1F, soft));
}

// Distance to the right of the way's centre line.
HWY_INLINE Floats aside_of(const Snapshot& snapshot, const Patch& patch) {
  constexpr auto kLast = static_cast<float>(Snapshot::kLineCount - 2);
  const Floats row =
      hn::Min(hn::Max(patch.z - number(static_cast<float>(Snapshot::kLineBegin)), number(0)),
              number(kLast));
  const Integers index = hn::Min(hn::Max(hn::ConvertTo(kIndexTag, row), integer(0)),
                                 integer(Snapshot::kLineCount - 2));
  const float* line = snapshot.centre_line.data();
  const Floats from = hn::GatherIndex(kTag, line, index);
  const Floats to = hn::GatherIndex(kTag, line + 1, index);
  return patch.x - (from + (to - from) * (row - hn::ConvertTo(kTag, index)));
}

HWY_INLINE Vectors ground_colour(const Snapshot& snapshot, const Patch& patch) {
  if (snapshot.ground == Ground::kFloor) {
    return coloured(snapshot.ground_dark, snapshot.ground_light,
                    ground_texture(snapshot.floor, patch, 1));
  }
  const bool street = snapshot.ground == Ground::kStreet;
  const Floats aside = aside_of(snapshot, patch);
  const Floats off = hn::Abs(aside);
  const Mask wild = hn::Gt(off, number(street ? 9.2F : 3.8F));
  const Mask middle = hn::Not(wild);
  Vectors colour = numbers({});
  // Most vectors lie in one zone.
  if (!hn::AllFalse(kTag, wild)) colour = meadow(snapshot, patch);
  if (!street) {
    if (hn::AllFalse(kTag, middle)) return colour;
    return choose(middle, sandy_way(snapshot, patch, off), colour);
  }
  const Mask paved = hn::And(middle, hn::Gt(off, number(5.4F)));
  const Mask driven = hn::AndNot(paved, middle);
  if (!hn::AllFalse(kTag, paved)) colour = choose(paved, pavement(snapshot, patch, off), colour);
  if (!hn::AllFalse(kTag, driven)) colour = choose(driven, road(patch, aside, off), colour);
  return colour;
}

void ground_kernel(const Snapshot& snapshot, float pixel, Range range, Surfaces& s) {
  const Vectors eye = numbers(snapshot.eye);
  for (std::size_t i = range.begin; i < range.end; i += hn::Lanes(kTag)) {
    const Vectors d = load(s.dx, s.dy, s.dz, i);
    const Floats t = hn::LoadU(kTag, &s.t[i]);
    const Vectors point = along(eye, d, t);
    const Floats across = t * number(pixel);
    const Floats slant = hn::Max(number(0.02F), hn::Abs(d.y));
    const Patch patch{point.x, point.z, across, across / hn::Sqrt(slant)};
    store_surface(snapshot, point, numbers({0, -1, 0}), ground_colour(snapshot, patch), i, s);
  }
}

// ---- light and sky ------------------------------------------------------------------------------

// How much of the light from all sides reaches a point: less in corners and near the ground.
HWY_INLINE Floats openness(const Snapshot& snapshot, const Vectors& at, Floats normal_y) {
  const Floats height = hn::Neg(at.y);
  if (!snapshot.indoor) {
    const Floats low = number(0.7F) + number(0.3F) * ramp(-0.1F, 0.7F, height);
    return choose(hn::Gt(normal_y, number(-0.9F)), low, number(1));
  }
  const Vectors room = numbers(snapshot.room);
  const Floats wall = hn::Min(room.x - hn::Abs(at.x), room.z - hn::Abs(at.z));
  const Mask upright = hn::Lt(hn::Abs(normal_y), number(0.5F));
  const Floats corner = choose(upright, hn::Min(height, room.y - height), wall);
  return number(0.72F) + number(0.28F) * ramp(-0.05F, 0.6F, corner);
}

void light_kernel(const Snapshot& snapshot, Range range, Surfaces& s) {
  const Floats one = number(1);
  for (std::size_t i = range.begin; i < range.end; i += hn::Lanes(kTag)) {
    const Vectors at = load(s.px, s.py, s.pz, i);
    const Floats up = hn::LoadU(kTag, &s.ny[i]);
    // Light from the sky or ceiling, and a little back from the ground.
    const Vectors ambient =
        sum(scaled(numbers(snapshot.sky_colour), number(0.78F) - number(0.22F) * up),
            scaled(numbers(snapshot.ground_light), number(0.1F) * (one + up)));
    const Vectors light = sum(scaled(ambient, openness(snapshot, at, up)),
                              scaled(numbers(snapshot.sun_colour), hn::LoadU(kTag, &s.direct[i])));
    const Vectors lit = product(load(s.r, s.g, s.b, i), light);
    // 1 - e^-x, near enough, of the square of the distance.
    const Floats far = hn::LoadU(kTag, &s.t[i]) * number(snapshot.haze);
    const Floats x = far * far;
    const Floats series = one + x * (one + x * (number(0.5F) + x * number(0.1667F)));
    store(mixed(lit, numbers(snapshot.haze_colour), one - one / series), i, s.r, s.g, s.b);
  }
}

void sky_kernel(const Snapshot& snapshot, float pixel, Range range, Surfaces& s) {
  const Floats zero = number(0);
  const Vectors haze = numbers(snapshot.haze_colour);
  const Vectors zenith = numbers({0.3F, 0.5F, 0.82F});
  const Vectors hills = mixed(haze, numbers({0.42F, 0.52F, 0.56F}), number(0.45F));
  for (std::size_t i = range.begin; i < range.end; i += hn::Lanes(kTag)) {
    const Vectors d = unit(load(s.dx, s.dy, s.dz, i));
    const Floats up = hn::Max(zero, hn::Neg(d.y));
    Vectors colour = mixed(haze, zenith, ramp(-0.05F, 0.55F, up));
    // Clouds on a plane far above, thinning out towards the horizon.
    const Floats per_height = number(1) / (up + number(0.12F));
    const Samples cloud = sample(Texture::kPlaster, d.x * per_height + number(0.3F),
                                 d.z * per_height, number(pixel) * per_height * per_height);
    const Floats cover = ramp(0.48F, 0.8F, cloud.mix) * ramp(0.02F, 0.2F, up);
    colour = mixed(colour, numbers({0.97F, 0.96F, 0.95F}), number(0.85F) * cover);
    const Floats glow = hn::Max(zero, inner(d, numbers(snapshot.sun)));
    const Floats glow4 = glow * glow * glow * glow;
    colour =
        sum(colour, scaled(numbers(snapshot.sun_colour), number(0.35F) * glow4 * glow4 * glow4));
    // Hills along the horizon; `around` goes once round the compass.
    const Floats turn = d.x / hn::Max(number(1e-6F), hn::Abs(d.x) + hn::Abs(d.z));
    const Floats around = choose(hn::Lt(d.z, zero), number(2) - turn, turn);
    const Floats ridge =
        number(0.015F) +
        number(0.09F) * sample(Texture::kPlaster, around, number(0.5F), number(0.02F)).mix;
    store(mixed(hills, colour, ramp(ridge - number(pixel), ridge + number(pixel), up)), i, s.r, s.g,
          s.b);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::scene
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm::scene {
HWY_EXPORT(primitive_kernel);
HWY_EXPORT(ground_kernel);
HWY_EXPORT(light_kernel);
HWY_EXPORT(sky_kernel);

void paint_primitive(const Snapshot& snapshot, const Primitive& primitive, float pixel, Range range,
                     Surfaces& surfaces) {
  HWY_DYNAMIC_DISPATCH(primitive_kernel)(snapshot, primitive, pixel, range, surfaces);
}

void paint_ground(const Snapshot& snapshot, float pixel, Range range, Surfaces& surfaces) {
  HWY_DYNAMIC_DISPATCH(ground_kernel)(snapshot, pixel, range, surfaces);
}

void light_surfaces(const Snapshot& snapshot, Range range, Surfaces& surfaces) {
  HWY_DYNAMIC_DISPATCH(light_kernel)(snapshot, range, surfaces);
}

void paint_sky(const Snapshot& snapshot, float pixel, Range range, Surfaces& surfaces) {
  HWY_DYNAMIC_DISPATCH(sky_kernel)(snapshot, pixel, range, surfaces);
}

}  // namespace lcdm::scene
#endif
