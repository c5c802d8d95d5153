// Vectors of numbers for the ray loops, once per instruction set. Include after hwy/highway.h.
#include "drivers/scene/scene.h"

#if defined(DRIVERS_SCENE_SIMD_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef DRIVERS_SCENE_SIMD_INL_H_
#undef DRIVERS_SCENE_SIMD_INL_H_
#else
#define DRIVERS_SCENE_SIMD_INL_H_
#endif

HWY_BEFORE_NAMESPACE();
namespace lcdm::scene {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using Tag = hn::CappedTag<float, 16>;
using Floats = hn::Vec<Tag>;
using Mask = hn::Mask<Tag>;
constexpr Tag kTag;
constexpr hn::RebindToSigned<Tag> kIndexTag;

struct Vectors {
  Floats x, y, z;
};

HWY_INLINE Floats number(float value) { return hn::Set(kTag, value); }
HWY_INLINE Vectors numbers(Vec3 v) { return {number(v.x), number(v.y), number(v.z)}; }
HWY_INLINE Floats inner(const Vectors& a, const Vectors& b) {
  return hn::MulAdd(a.x, b.x, hn::MulAdd(a.y, b.y, hn::Mul(a.z, b.z)));
}
HWY_INLINE Vectors along(const Vectors& from, const Vectors& direction, Floats t) {
  return {hn::MulAdd(direction.x, t, from.x), hn::MulAdd(direction.y, t, from.y),
          hn::MulAdd(direction.z, t, from.z)};
}
// World to the primitive's own axes: a turn about the vertical.
HWY_INLINE Vectors into_local(const Primitive& p, const Vectors& v) {
  const Floats c = number(p.cos_yaw);
  const Floats s = number(p.sin_yaw);
  return {hn::NegMulAdd(s, v.z, hn::Mul(c, v.x)), v.y, hn::MulAdd(s, v.x, hn::Mul(c, v.z))};
}

HWY_INLINE Vectors out_of_local(const Primitive& p, const Vectors& v) {
  const Floats c = number(p.cos_yaw);
  const Floats s = number(p.sin_yaw);
  return {hn::MulAdd(s, v.z, hn::Mul(c, v.x)), v.y, hn::NegMulAdd(s, v.x, hn::Mul(c, v.z))};
}

HWY_INLINE Floats guarded_inverse(Floats d) {
  const Floats tiny = number(1e-12F);
  return hn::Div(number(1), hn::IfThenElse(hn::Lt(hn::Abs(d), tiny), tiny, d));
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::scene
HWY_AFTER_NAMESPACE();

#endif
