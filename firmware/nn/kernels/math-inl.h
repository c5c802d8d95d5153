// Vector mathematics shared by the kernels: once per instruction set, hence the odd guard.
#if defined(LCDM_KERNELS_MATH_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef LCDM_KERNELS_MATH_INL_H
#undef LCDM_KERNELS_MATH_INL_H
#else
#define LCDM_KERNELS_MATH_INL_H
#endif

#include <cstddef>
#include <type_traits>

#include "firmware/nn/network.h"

#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using FullTag = HWY_FULL(float);
using FullVec = hn::Vec<FullTag>;
constexpr std::size_t kLanes = HWY_LANES(float);

// e^x within 3e-7 relative for x in [-87, 88], clamped outside. x = n log(2) + r; n is rounded by
// adding and taking away 1.5 * 2^23, whose lowest bits then hold it; e^r by a polynomial fitted to
// half a log(2) either way within 1e-7; n is added to its exponent.
template <class D, class V>
HWY_INLINE V exp_approx(D d, V x) {
  const hn::RebindToSigned<D> di;
  const auto magic = hn::Set(d, 12582912.0F);
  x = hn::Min(hn::Max(x, hn::Set(d, -87.0F)), hn::Set(d, 88.0F));
  const V shifted = hn::MulAdd(x, hn::Set(d, 1.44269504F), magic);
  const V n = hn::Sub(shifted, magic);
  V r = hn::NegMulAdd(n, hn::Set(d, 0.693359375F), x);  // exact, also without fused multiply-adds
  r = hn::NegMulAdd(n, hn::Set(d, -2.12194440e-4F), r);
  V p = hn::MulAdd(hn::Set(d, 8.290315572e-03F), r, hn::Set(d, 4.189793655e-02F));
  p = hn::MulAdd(p, r, hn::Set(d, 1.666763623e-01F));
  p = hn::MulAdd(p, r, hn::Set(d, 4.999914948e-01F));
  p = hn::MulAdd(p, r, hn::Set(d, 9.999997072e-01F));
  p = hn::MulAdd(p, r, hn::Set(d, 1.0F));
  return hn::BitCast(d, hn::Add(hn::BitCast(di, p), hn::ShiftLeft<23>(hn::BitCast(di, shifted))));
}

// 2^x within 3e-7 relative for x in [-126, 126]. As above, without log(2): the same polynomial of
// x - n, its coefficients times the powers of log(2).
template <class D, class V>
HWY_INLINE V exp2_within(D d, V x) {
  const hn::RebindToSigned<D> di;
  const auto magic = hn::Set(d, 12582912.0F);
  const V shifted = hn::Add(x, magic);
  const V r = hn::Sub(x, hn::Sub(shifted, magic));
  V p = hn::MulAdd(hn::Set(d, 1.326472857e-03F), r, hn::Set(d, 9.671514314e-03F));
  p = hn::MulAdd(p, r, hn::Set(d, 5.550733755e-02F));
  p = hn::MulAdd(p, r, hn::Set(d, 2.402224206e-01F));
  p = hn::MulAdd(p, r, hn::Set(d, 6.931469776e-01F));
  p = hn::MulAdd(p, r, hn::Set(d, 1.0F));
  return hn::BitCast(d, hn::Add(hn::BitCast(di, p), hn::ShiftLeft<23>(hn::BitCast(di, shifted))));
}

// The same within 1.1e-4, beside narrow numbers: the polynomial has degree 3.
template <class D, class V>
HWY_INLINE V rough_exp2_within(D d, V x) {
  const hn::RebindToSigned<D> di;
  const auto magic = hn::Set(d, 12582912.0F);
  const V shifted = hn::Add(x, magic);
  const V r = hn::Sub(x, hn::Sub(shifted, magic));
  V p = hn::MulAdd(hn::Set(d, 5.501141659e-02F), r, hn::Set(d, 2.422012370e-01F));
  p = hn::MulAdd(p, r, hn::Set(d, 6.932815963e-01F));
  p = hn::MulAdd(p, r, hn::Set(d, 1.0F));
  return hn::BitCast(d, hn::Add(hn::BitCast(di, p), hn::ShiftLeft<23>(hn::BitCast(di, shifted))));
}

// 1 / x for positive x, within 2e-7 relative.
template <class D, class V>
HWY_INLINE V reciprocal(D d, V x) {
  if constexpr (HWY_TARGET == HWY_AVX3 && sizeof(V) == 64) {
    // The estimate has 14 bits (12 in narrower vectors); one step of Newton's doubles them, in half
    // a division's time.
    const V r = hn::ApproximateReciprocal(x);
    return hn::Mul(r, hn::NegMulAdd(x, r, hn::Set(d, 2.0F)));
  } else {
    return hn::Div(hn::Set(d, 1.0F), x);
  }
}

// e^-x within 1.1e-4 relative for x in [-88, 87], clamped above, and e^0 is 1: for what narrow
// numbers follow or precede. As exp_approx, but n log(2) is taken away at once and the polynomial
// has degree 3.
template <class D, class V>
HWY_INLINE V rough_exp_minus(D d, V x) {
  const hn::RebindToSigned<D> di;
  const auto magic = hn::Set(d, 12582912.0F);
  x = hn::Min(x, hn::Set(d, 87.0F));
  const V shifted = hn::MulAdd(x, hn::Set(d, -1.44269504F), magic);
  const V r = hn::MulAdd(hn::Sub(shifted, magic), hn::Set(d, 0.693147181F), x);
  V p = hn::MulAdd(hn::Set(d, -1.651872204e-01F), r, hn::Set(d, 5.041101419e-01F));
  p = hn::MulAdd(p, r, hn::Set(d, -1.000193921F));
  p = hn::MulAdd(p, r, hn::Set(d, 1.0F));
  return hn::BitCast(d, hn::Add(hn::BitCast(di, p), hn::ShiftLeft<23>(hn::BitCast(di, shifted))));
}

// 1 / x for positive x, within 4e-4 relative.
template <class D, class V>
HWY_INLINE V rough_reciprocal([[maybe_unused]] D d, V x) {
  const V r = hn::ApproximateReciprocal(x);
  if constexpr (HWY_TARGET == HWY_NEON) {  // where the estimate has 8 bits
    return hn::Mul(r, hn::NegMulAdd(x, r, hn::Set(d, 2.0F)));
  } else {
    return r;
  }
}

// kRough: within 5e-4 relative, beside narrow products.
template <Activation kActivation, bool kRough = false, class D, class V>
HWY_INLINE V activate(D d, V x) {
  const V zero = hn::Zero(d);
  const V one = hn::Set(d, 1.0F);
  if constexpr (kActivation == Activation::kSilu && kRough) {
    const V e = rough_exp_minus(d, hn::Max(x, hn::Set(d, -88.0F)));
    return hn::Mul(x, rough_reciprocal(d, hn::Add(one, e)));
  } else if constexpr (kActivation == Activation::kSilu) {
    return hn::Mul(x, reciprocal(d, hn::Add(one, exp_approx(d, hn::Sub(zero, x)))));
  } else if constexpr (kActivation == Activation::kElu && kRough) {
    return hn::IfThenElse(hn::Gt(x, zero), x, hn::Sub(rough_exp_minus(d, hn::Abs(x)), one));
  } else if constexpr (kActivation == Activation::kElu) {
    return hn::IfThenElse(hn::Gt(x, zero), x, hn::Sub(exp_approx(d, x), one));
  } else if constexpr (kActivation == Activation::kRelu) {
    return hn::Max(x, zero);
  } else {
    return x;
  }
}

// Calls f(std::integral_constant) with the activation, chosen once for all that f does.
template <class F>
HWY_INLINE void with_activation(Activation activation, F&& f) {
  switch (activation) {
    case Activation::kNone:
      return f(std::integral_constant<Activation, Activation::kNone>());
    case Activation::kSilu:
      return f(std::integral_constant<Activation, Activation::kSilu>());
    case Activation::kElu:
      return f(std::integral_constant<Activation, Activation::kElu>());
    case Activation::kRelu:
      return f(std::integral_constant<Activation, Activation::kRelu>());
  }
}

// Calls f(tag, first) for consecutive runs of channels: whole vectors, then eights, fours and
// single ones, each with a tag of that many lanes.
template <class F>
HWY_INLINE void for_channels(std::size_t channels, F&& f) {
  const FullTag full;
  const HWY_CAPPED(float, 8) eight;
  const HWY_CAPPED(float, 4) four;
  const HWY_CAPPED(float, 1) one;
  std::size_t c = 0;
  for (; c + hn::Lanes(full) <= channels; c += hn::Lanes(full)) f(full, c);
  for (; c + hn::Lanes(eight) <= channels; c += hn::Lanes(eight)) f(eight, c);
  for (; c + hn::Lanes(four) <= channels; c += hn::Lanes(four)) f(four, c);
  for (; c < channels; ++c) f(one, c);
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#endif
