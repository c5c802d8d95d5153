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

#if HWY_TARGET == HWY_AVX3
// x / (1 + e^-x) within 1.1e-4: of |x| in 32 steps of 0.4 the difference from max(x, 0), which is 0
// from 12.2 on, by a polynomial of degree 2 each. Two thirds of the operations that a power and a
// division take.
HWY_INLINE FullVec silu_by_table(FullTag d, FullVec x) {
  HWY_ALIGN static constexpr float kSquare[2 * kLanes] = {
      -2.48746306e-01F, -2.30291754e-01F, -1.81223705e-01F, -1.20673291e-01F, -6.57548234e-02F,
      -2.52769180e-02F, -1.61177406e-04F, 1.28179025e-02F,  1.77929550e-02F,  1.81993712e-02F,
      1.63800400e-02F,  1.37376348e-02F,  1.10217258e-02F,  8.58064182e-03F,  6.53789518e-03F,
      4.90213698e-03F,  3.63047188e-03F,  2.66248919e-03F,  1.93715328e-03F,  1.40018691e-03F,
      1.00647821e-03F,  7.20058451e-04F,  5.13039995e-04F,  3.64230131e-04F,  2.57764012e-04F,
      1.81903015e-04F,  1.28042491e-04F,  8.99231018e-05F,  6.30206123e-05F,  4.40825643e-05F,
      3.07817136e-05F,  0.00000000e+00F};
  HWY_ALIGN static constexpr float kLinear[2 * kLanes] = {
      4.99895453e-01F,  4.90361094e-01F,  4.30312514e-01F,  3.09119582e-01F,  1.55985698e-01F,
      1.11348601e-02F,  -9.86074805e-02F, -1.65555462e-01F, -1.95076078e-01F, -1.97666526e-01F,
      -1.83765113e-01F, -1.61549792e-01F, -1.36571884e-01F, -1.12180874e-01F, -9.01417881e-02F,
      -7.11881742e-02F, -5.54376766e-02F, -4.26750593e-02F, -3.25319432e-02F, -2.45937258e-02F,
      -1.84585676e-02F, -1.37662645e-02F, -1.02092130e-02F, -7.53331231e-03F, -5.53368870e-03F,
      -4.04821057e-03F, -2.95045762e-03F, -2.14304193e-03F, -1.55169563e-03F, -1.12026872e-03F,
      -8.06623371e-04F, 0.00000000e+00F};
  HWY_ALIGN static constexpr float kConstant[2 * kLanes] = {
      0.00000000e+00F, 1.22717815e-03F, 1.97535884e-02F, 8.05963203e-02F, 1.87525824e-01F,
      3.17243785e-01F, 4.37200814e-01F, 5.23570657e-01F, 5.67373872e-01F, 5.71484864e-01F,
      5.44924617e-01F, 4.98223603e-01F, 4.40784842e-01F, 3.79848748e-01F, 3.20397347e-01F,
      2.65487880e-01F, 2.16713339e-01F, 1.74642146e-01F, 1.39179364e-01F, 1.09839052e-01F,
      8.59367400e-02F, 6.67177588e-02F, 5.14375120e-02F, 3.94075029e-02F, 3.00180316e-02F,
      2.27457825e-02F, 1.71521716e-02F, 1.28765320e-02F, 9.62683465e-03F, 7.16969324e-03F,
      5.32064401e-03F, 0.00000000e+00F};
  // Positive floats are in the order of their bits; 12.4 is in the last step.
  const __m512i bits = _mm512_and_si512(_mm512_castps_si512(x.raw), _mm512_set1_epi32(0x7FFFFFFF));
  const FullVec a{_mm512_castsi512_ps(_mm512_min_epi32(bits, _mm512_set1_epi32(0x41466666)))};
  // Its lowest bits are the step.
  const __m512i step =
      _mm512_castps_si512(hn::MulAdd(a, hn::Set(d, 2.5F), hn::Set(d, 12582912.0F)).raw);
  const auto of_step = [&](const float* table) HWY_ATTR {
    return FullVec{
        _mm512_permutex2var_ps(_mm512_load_ps(table), step, _mm512_load_ps(table + kLanes))};
  };
  const FullVec less =
      hn::MulAdd(hn::MulAdd(of_step(kSquare), a, of_step(kLinear)), a, of_step(kConstant));
  return hn::Sub(hn::Max(hn::Zero(d), x), less);  // the second where x is not a number
}
#endif

// kRough: within 1e-4 and 5e-4 of the value, beside narrow products.
template <Activation kActivation, bool kRough = false, class D, class V>
HWY_INLINE V activate(D d, V x) {
  const V zero = hn::Zero(d);
  const V one = hn::Set(d, 1.0F);
#if HWY_TARGET == HWY_AVX3
  if constexpr (kActivation == Activation::kSilu && kRough && sizeof(V) == 64) {
    return silu_by_table(d, x);
  }
#endif
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
