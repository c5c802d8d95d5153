#include "drivers/scene/trace.h"

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "drivers/scene/trace.cpp"
#include "firmware/base/simd.h"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>
#include "drivers/scene/simd-inl.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace lcdm::scene {
namespace HWY_NAMESPACE {

// One vector of rays, seen from a primitive's centre.
struct Rays {
  Vectors origin;
  Vectors direction;
  Floats inverse_dd;
};

// Where a ray comes nearest to the centre, and that point. Solving from there instead of from the
// origin keeps single precision exact enough: no large squares are subtracted.
struct Nearest {
  Floats t;
  Vectors point;
};
HWY_INLINE Nearest nearest_to_centre(const Rays& r) {
  const Floats t = hn::Neg(hn::Mul(inner(r.origin, r.direction), r.inverse_dd));
  return {t, along(r.origin, r.direction, t)};
}

struct Hits {
  Floats t;
  Mask valid;
};

HWY_INLINE Hits hit_sphere(const Primitive& p, const Rays& r) {
  const Nearest n = nearest_to_centre(r);
  const Floats room = hn::Sub(number(p.radius * p.radius), inner(n.point, n.point));
  const Floats half_chord = hn::Sqrt(hn::Mul(hn::Max(room, hn::Zero(kTag)), r.inverse_dd));
  return {hn::Sub(n.t, half_chord), hn::Gt(room, hn::Zero(kTag))};
}

HWY_INLINE Hits hit_box(const Primitive& p, const Rays& r) {
  const Vectors o = into_local(p, r.origin);
  const Vectors d = into_local(p, r.direction);
  const Vectors inverse{guarded_inverse(d.x), guarded_inverse(d.y), guarded_inverse(d.z)};
  // Per axis the slab is entered at middle - half and left at middle + half.
  const auto middle = [](Floats from, Floats inv) { return hn::Neg(hn::Mul(from, inv)); };
  const auto half = [](float size, Floats inv) { return hn::Abs(hn::Mul(number(size), inv)); };
  const Floats mx = middle(o.x, inverse.x);
  const Floats my = middle(o.y, inverse.y);
  const Floats mz = middle(o.z, inverse.z);
  const Floats hx = half(p.half.x, inverse.x);
  const Floats hy = half(p.half.y, inverse.y);
  const Floats hz = half(p.half.z, inverse.z);
  const Floats enter = hn::Max(hn::Sub(mx, hx), hn::Max(hn::Sub(my, hy), hn::Sub(mz, hz)));
  const Floats leave = hn::Min(hn::Add(mx, hx), hn::Min(hn::Add(my, hy), hn::Add(mz, hz)));
  return {enter, hn::Le(enter, leave)};
}

// The cylinder about the axis, and where that is missed a ball at the nearer end.
HWY_INLINE Hits hit_capsule(const Primitive& p, const Rays& r) {
  const Nearest n = nearest_to_centre(r);
  const Floats zero = hn::Zero(kTag);
  const Vectors axis = numbers(p.half);
  const Floats aa = number(dot(p.half, p.half));
  const Floats rr = number(p.radius * p.radius);
  const Floats ad = inner(axis, r.direction);
  const Floats ap = inner(axis, n.point);
  const Floats dp = inner(r.direction, n.point);
  const Floats pp = inner(n.point, n.point);
  const Floats dd = hn::Div(number(1), r.inverse_dd);
  const Floats a = hn::Max(hn::NegMulAdd(ad, ad, hn::Mul(aa, dd)), number(1e-12F));
  const Floats b = hn::NegMulAdd(ap, ad, hn::Mul(aa, dp));
  const Floats c = hn::NegMulAdd(ap, ap, hn::Mul(aa, hn::Sub(pp, rr)));
  const Floats room = hn::NegMulAdd(a, c, hn::Mul(b, b));
  const Mask cylinder = hn::Ge(room, zero);
  if (hn::AllFalse(kTag, cylinder)) return {zero, cylinder};

  const Floats side_t = hn::Div(hn::Neg(hn::Add(b, hn::Sqrt(hn::Max(room, zero)))), a);
  const Floats height = hn::MulAdd(side_t, ad, ap);  // along the axis, +-aa at its ends
  const Mask on_side = hn::Lt(hn::Abs(height), aa);

  const Floats end = hn::CopySign(number(1), height);
  const Vectors from{hn::NegMulAdd(end, axis.x, n.point.x), hn::NegMulAdd(end, axis.y, n.point.y),
                     hn::NegMulAdd(end, axis.z, n.point.z)};
  const Floats towards = hn::Mul(inner(r.direction, from), r.inverse_dd);
  const Vectors closest = along(from, r.direction, hn::Neg(towards));
  const Floats end_room = hn::Sub(rr, inner(closest, closest));
  const Floats end_t =
      hn::Neg(hn::Add(towards, hn::Sqrt(hn::Mul(hn::Max(end_room, zero), r.inverse_dd))));
  const Mask valid = hn::And(cylinder, hn::Or(on_side, hn::Ge(end_room, zero)));
  return {hn::Add(n.t, hn::IfThenElse(on_side, side_t, end_t)), valid};
}

// Marched by the distance to the surface inside the bounding ball, then polished by Newton's rule.
HWY_INLINE Hits hit_hoop(const Primitive& p, const Rays& r) {
  const Nearest n = nearest_to_centre(r);
  const Floats zero = hn::Zero(kTag);
  const Floats room = hn::Sub(number(p.bound * p.bound), inner(n.point, n.point));
  Mask active = hn::Gt(room, zero);
  if (hn::AllFalse(kTag, active)) return {zero, active};

  const Vectors from = into_local(p, n.point);
  const Vectors d = into_local(p, r.direction);
  const Floats half_chord = hn::Sqrt(hn::Mul(hn::Max(room, zero), r.inverse_dd));
  const Floats per_metre = hn::Sqrt(r.inverse_dd);
  const Floats ring = number(p.half.x);
  const Floats tube = number(p.radius);
  const auto to_ring = [&](const Vectors& at, Floats& outward) {
    const Floats planar = hn::Sqrt(hn::MulAdd(at.x, at.x, hn::Mul(at.y, at.y)));
    outward = hn::Sub(planar, ring);
    return planar;
  };
  constexpr int kSteps = 48;
  const Floats close = number(5e-4F);
  Floats t = hn::Neg(half_chord);
  Mask found = hn::And(active, hn::Not(active));
  for (int i = 0; i < kSteps && !hn::AllFalse(kTag, active); ++i) {
    Floats outward;
    const Vectors at = along(from, d, t);
    to_ring(at, outward);
    const Floats distance =
        hn::Sub(hn::Sqrt(hn::MulAdd(outward, outward, hn::Mul(at.z, at.z))), tube);
    const Mask arrived = hn::And(active, hn::Lt(distance, close));
    found = hn::Or(found, arrived);
    active = hn::And(hn::AndNot(arrived, active), hn::Lt(t, half_chord));
    t = hn::MulAdd(hn::IfThenElseZero(active, distance), per_metre, t);
  }
  for (int i = 0; i < 2; ++i) {
    // f = outward^2 + z^2 - tube^2; f' = 2 (outward * (x dx + y dy) / planar + z dz).
    Floats outward;
    const Vectors at = along(from, d, t);
    const Floats planar = to_ring(at, outward);
    const Floats value =
        hn::Sub(hn::MulAdd(outward, outward, hn::Mul(at.z, at.z)), hn::Mul(tube, tube));
    const Floats growth = hn::Div(hn::MulAdd(at.x, d.x, hn::Mul(at.y, d.y)), planar);
    const Floats slope = hn::Mul(number(2), hn::MulAdd(outward, growth, hn::Mul(at.z, d.z)));
    // At the rim the ray only touches and the slope vanishes: the march was near enough there.
    const Mask steep = hn::Lt(slope, number(-1e-3F));
    t = hn::Sub(t, hn::IfThenElseZero(steep, hn::Div(value, slope)));
  }
  return {hn::Add(n.t, t), found};
}

HWY_INLINE Hits hit_primitive(const Primitive& p, const Rays& rays) {
  switch (p.shape) {
    case Shape::kSphere:
      return hit_sphere(p, rays);
    case Shape::kBox:
      return hit_box(p, rays);
    case Shape::kCapsule:
      return hit_capsule(p, rays);
    case Shape::kHoop:
      return hit_hoop(p, rays);
  }
  return {hn::Zero(kTag), hn::MaskFromVec(hn::Zero(kTag))};
}

void trace_primitive(const Primitive& p, std::int32_t index, RayBatch& rays) {
  const Vectors centre = numbers(p.centre);
  const auto step = hn::Lanes(kTag);
  for (std::size_t i = 0; i < static_cast<std::size_t>(rays.count); i += step) {
    const Rays r{
        {hn::Sub(hn::Load(kTag, &rays.ox[i]), centre.x),
         hn::Sub(hn::Load(kTag, &rays.oy[i]), centre.y),
         hn::Sub(hn::Load(kTag, &rays.oz[i]), centre.z)},
        {hn::Load(kTag, &rays.dx[i]), hn::Load(kTag, &rays.dy[i]), hn::Load(kTag, &rays.dz[i])},
        hn::Load(kTag, &rays.inverse_dd[i])};
    const Floats before = hn::Load(kTag, &rays.t[i]);
    const Hits hits = hit_primitive(p, r);
    const Mask nearer =
        hn::And(hits.valid, hn::And(hn::Gt(hits.t, number(1e-3F)), hn::Lt(hits.t, before)));
    if (hn::AllFalse(kTag, nearer)) continue;
    hn::Store(hn::IfThenElse(nearer, hits.t, before), kTag, &rays.t[i]);
    const auto old = hn::Load(kIndexTag, &rays.hit[i]);
    hn::Store(hn::IfThenElse(hn::RebindMask(kIndexTag, nearer), hn::Set(kIndexTag, index), old),
              kIndexTag, &rays.hit[i]);
  }
}

void trace_all(std::span<const Primitive> primitives, std::span<const std::uint16_t> chosen,
               RayBatch& rays) {
  const auto step = hn::Lanes(kTag);
  for (std::size_t i = 0; i < static_cast<std::size_t>(rays.count); i += step) {
    const Vectors d{hn::Load(kTag, &rays.dx[i]), hn::Load(kTag, &rays.dy[i]),
                    hn::Load(kTag, &rays.dz[i])};
    hn::Store(hn::Div(number(1), inner(d, d)), kTag, &rays.inverse_dd[i]);
  }
  for (const std::uint16_t i : chosen) trace_primitive(primitives[i], i, rays);
}

void trace_plane(float limit, RayBatch& rays) {
  const auto step = hn::Lanes(kTag);
  for (std::size_t i = 0; i < static_cast<std::size_t>(rays.count); i += step) {
    const Floats dy = hn::Load(kTag, &rays.dy[i]);
    const Floats t = hn::Mul(hn::Neg(hn::Load(kTag, &rays.oy[i])), guarded_inverse(dy));
    const Floats before = hn::Load(kTag, &rays.t[i]);
    const Mask nearer = hn::And(hn::And(hn::Gt(dy, hn::Zero(kTag)), hn::Gt(t, hn::Zero(kTag))),
                                hn::And(hn::Lt(t, number(limit)), hn::Lt(t, before)));
    hn::Store(hn::IfThenElse(nearer, t, before), kTag, &rays.t[i]);
    const auto old = hn::Load(kIndexTag, &rays.hit[i]);
    hn::Store(
        hn::IfThenElse(hn::RebindMask(kIndexTag, nearer), hn::Set(kIndexTag, kHitGround), old),
        kIndexTag, &rays.hit[i]);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::scene
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm::scene {
HWY_EXPORT(trace_all);
HWY_EXPORT(trace_plane);

void trace(std::span<const Primitive> primitives, std::span<const std::uint16_t> chosen,
           RayBatch& rays) {
  HWY_DYNAMIC_DISPATCH(trace_all)(primitives, chosen, rays);
}

void trace_ground(float limit, RayBatch& rays) { HWY_DYNAMIC_DISPATCH(trace_plane)(limit, rays); }

}  // namespace lcdm::scene
#endif
