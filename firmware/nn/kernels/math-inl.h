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

// Added to a number of moderate size it rounds it to a whole n, which the lowest bits then hold.
constexpr float kRounding = 12582912.0F;  // 1.5 * 2^23

// p * 2^n of n + kRounding: n is added to the exponent.
template <class D, class V>
HWY_INLINE V times_power_of_two(D d, V p, V n_shifted) {
  const hn::RebindToSigned<D> di;
  const auto exponent = hn::ShiftLeft<23>(hn::BitCast(di, n_shifted));
  return hn::BitCast(d, hn::Add(hn::BitCast(di, p), exponent));
}

// The same pointer, but the compiler cannot have read before what is read through it. Otherwise it
// keeps the constants of what follows a tile of products in registers all through the tile's loop,
// and sums go through memory instead, where the tile needs every register: seen with 32 of them;
// with 16 constants are read from memory anyway.
template <class T>
HWY_INLINE const T* read_only_now(const T* constants) {
#if HWY_TARGET == HWY_AVX3 || HWY_ARCH_ARM
  asm volatile("" : "+r"(constants));
#endif
  return constants;
}

// Of a number whose whole part n was taken away its power, polynomial(r), times 2^n: AVX-512 has
// instructions for both, and n is the one below x instead of the nearest.
template <class Polynomial>
HWY_INLINE FullVec exp2_by([[maybe_unused]] FullTag d, FullVec x,
                           [[maybe_unused]] const float& rounding, const Polynomial& polynomial) {
#if HWY_TARGET == HWY_AVX3
  const FullVec r{_mm512_reduce_ps(x.raw, _MM_FROUND_TO_NEG_INF)};
  return FullVec{_mm512_scalef_ps(polynomial(r).raw, x.raw)};
#else
  const auto round = hn::Set(d, rounding);
  const auto shifted = hn::Add(x, round);
  const auto r = hn::Sub(x, hn::Sub(shifted, round));
  return times_power_of_two(d, polynomial(r), shifted);
#endif
}

// 2^x for x in [-126, 126], within 3e-7 relative: e^r's polynomial (exp_approx), its coefficients
// times the powers of log(2), or one fitted to [0, 1) within 1e-7.
HWY_INLINE FullVec exp2_within(FullTag d, FullVec x) {
#if HWY_TARGET == HWY_AVX3
  constexpr float kTerms[] = {1.867130638e-03F, 9.017029102e-03F, 5.579991399e-02F,
                              2.401644499e-01F, 6.931513118e-01F, 1};
#else
  constexpr float kTerms[] = {1.326472857e-03F, 9.671514314e-03F, 5.550733755e-02F,
                              2.402224206e-01F, 6.931469776e-01F, 1};
#endif
  return exp2_by(d, x, kRounding, [&](FullVec r) HWY_ATTR {
    FullVec p = hn::MulAdd(hn::Set(d, kTerms[0]), r, hn::Set(d, kTerms[1]));
    LCDM_UNROLL for (int i = 2; i < 6; ++i) p = hn::MulAdd(p, r, hn::Set(d, kTerms[i]));
    return p;
  });
}

// What exp2_times_constant computes from: a polynomial of degree 4 whose r^4 counts once.
struct PowerTerms {
  float term[4];
  float rounding = kRounding;  // for processors that have to round so
};
#if HWY_TARGET == HWY_AVX3
static constexpr PowerTerms kPowerTerms = {
    {3.842974165F, 17.83949711F, 51.20402040F, 73.88725814F}};
#else
static constexpr PowerTerms kPowerTerms = {
    {5.842974347F, 25.10395897F, 72.42574986F, 104.4920169F}};
#endif

// 2^x times a constant near 74 (104 without AVX-512's instructions) for x in [-126, 119], within
// 3e-6 relative, for a softmax: it divides by the sum of what it gets, so a factor does not matter,
// and the error is about what a sum of a thousand floats may lose. Two operations fewer for each
// score on a processor's multipliers. `terms` are kPowerTerms.
HWY_INLINE FullVec exp2_times_constant(FullTag d, FullVec x, const PowerTerms& terms) {
  return exp2_by(d, x, terms.rounding, [&](FullVec r) HWY_ATTR {
    FullVec p = hn::Add(r, hn::Set(d, terms.term[0]));
    LCDM_UNROLL for (int i = 1; i < 4; ++i) p = hn::MulAdd(p, r, hn::Set(d, terms.term[i]));
    return p;
  });
}

// e^(kSign x), of a kSign of 1 or -1, within 3e-7 relative for x in [-87, 87], clamped outside.
// kSign x = n log(2) + r, and e^r by a polynomial fitted to half a log(2) either way within 1e-7.
// Of whole AVX-512 vectors a power of two, whose exponent is rounded: 6e-8 |x| more, and nothing is
// clamped below, where it falls to 0.
template <int kSign, class D, class V>
HWY_INLINE V exp_approx(D d, V x) {
#if HWY_TARGET == HWY_AVX3
  if constexpr (sizeof(V) == 64) {
    x = hn::Mul(x, hn::Set(d, kSign * 1.44269504F));
    return exp2_within(d, hn::Min(x, hn::Set(d, 126.0F)));
  }
#endif
  if constexpr (kSign < 0) x = hn::Sub(hn::Zero(d), x);
  const auto rounding = hn::Set(d, kRounding);
  x = hn::Min(hn::Max(x, hn::Set(d, -87.0F)), hn::Set(d, 88.0F));
  const V shifted = hn::MulAdd(x, hn::Set(d, 1.44269504F), rounding);
  const V n = hn::Sub(shifted, rounding);
  V r = hn::NegMulAdd(n, hn::Set(d, 0.693359375F), x);  // exact, also without fused multiply-adds
  r = hn::NegMulAdd(n, hn::Set(d, -2.12194440e-4F), r);
  V p = hn::MulAdd(hn::Set(d, 8.290315572e-03F), r, hn::Set(d, 4.189793655e-02F));
  p = hn::MulAdd(p, r, hn::Set(d, 1.666763623e-01F));
  p = hn::MulAdd(p, r, hn::Set(d, 4.999914948e-01F));
  p = hn::MulAdd(p, r, hn::Set(d, 9.999997072e-01F));
  p = hn::MulAdd(p, r, hn::Set(d, 1.0F));
  return times_power_of_two(d, p, shifted);
}

// 2^x for x in [-126, 126] within 1.1e-4, beside narrow numbers: the polynomial has degree 3.
template <class D, class V>
HWY_INLINE V rough_exp2_within(D d, V x) {
  const auto rounding = hn::Set(d, kRounding);
  const V shifted = hn::Add(x, rounding);
  const V r = hn::Sub(x, hn::Sub(shifted, rounding));
  V p = hn::MulAdd(hn::Set(d, 5.501141659e-02F), r, hn::Set(d, 2.422012370e-01F));
  p = hn::MulAdd(p, r, hn::Set(d, 6.932815963e-01F));
  return times_power_of_two(d, hn::MulAdd(p, r, hn::Set(d, 1.0F)), shifted);
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
  const auto rounding = hn::Set(d, kRounding);
  x = hn::Min(x, hn::Set(d, 87.0F));
  const V shifted = hn::MulAdd(x, hn::Set(d, -1.44269504F), rounding);
  const V r = hn::MulAdd(hn::Sub(shifted, rounding), hn::Set(d, 0.693147181F), x);
  V p = hn::MulAdd(hn::Set(d, -1.651872204e-01F), r, hn::Set(d, 5.041101419e-01F));
  p = hn::MulAdd(p, r, hn::Set(d, -1.000193921F));
  return times_power_of_two(d, hn::MulAdd(p, r, hn::Set(d, 1.0F)), shifted);
}

// 1 / x for positive x, within 4e-4 relative.
template <class D, class V>
HWY_INLINE V rough_reciprocal([[maybe_unused]] D d, V x) {
  const V r = hn::ApproximateReciprocal(x);
  if constexpr (HWY_ARCH_ARM) {  // where the estimate has 8 bits
    return hn::Mul(r, hn::NegMulAdd(x, r, hn::Set(d, 2.0F)));
  } else {
    return r;
  }
}

#if HWY_TARGET == HWY_AVX3
// x / (1 + e^-x) within 4e-4: of |x| in 16 steps the difference from max(x, 0), which is as good as
// 0 from 9.5 on, by a polynomial of degree 2 each. Half of the operations that a power and a
// division take; of more steps each table would be two vectors, and to load them takes longest.
HWY_INLINE FullVec silu_by_table(FullTag d, FullVec x) {
  HWY_ALIGN static constexpr float kSquare[kLanes] = {
      -2.38634690e-01F, -1.67517899e-01F, -8.09238899e-02F, -1.98648832e-02F,
      9.33778900e-03F,  1.79306045e-02F,  1.71200556e-02F,  1.33712040e-02F,
      9.48727038e-03F,  6.37071072e-03F,  4.13035903e-03F,  2.61417745e-03F,
      1.62588975e-03F,  9.97885639e-04F,  6.06078958e-04F,  3.65003139e-04F};
  HWY_ALIGN static constexpr float kLinear[kLanes] = {
      4.97154958e-01F,  4.08930830e-01F,  2.04313863e-01F,  -1.00294907e-02F,
      -1.46211831e-01F, -1.95916730e-01F, -1.89647729e-01F, -1.58388662e-01F,
      -1.21541149e-01F, -8.83166909e-02F, -6.17886678e-02F, -4.20414464e-02F,
      -2.79988168e-02F, -1.83309379e-02F, -1.18345193e-02F, -8.15762597e-03F};
  HWY_ALIGN static constexpr float kConstant[kLanes] = {
      0.00000000e+00F, 2.78213882e-02F, 1.49304741e-01F, 3.37819565e-01F,
      4.96753442e-01F, 5.68652346e-01F, 5.56603881e-01F, 4.91416434e-01F,
      4.03993896e-01F, 3.15423264e-01F, 2.36877722e-01F, 1.72568541e-01F,
      1.22678499e-01F, 8.54658019e-02F, 5.85343231e-02F, 4.49076356e-02F};
  // Positive floats are in the order of their bits; 9.4999 is in the last step.
  const __m512i bits = _mm512_and_si512(_mm512_castps_si512(x.raw), _mm512_set1_epi32(0x7FFFFFFF));
  const FullVec a{_mm512_castsi512_ps(_mm512_min_epi32(bits, _mm512_set1_epi32(0x4117FF97)))};
  // Its lowest bits are the step, rounded down.
  const __m512i step = _mm512_castps_si512(
      _mm512_fmadd_round_ps(a.raw, _mm512_set1_ps(16 / 9.5F), _mm512_set1_ps(kRounding),
                            _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC));
  const auto of_step = [&](const float* table) HWY_ATTR {
    return FullVec{_mm512_permutexvar_ps(step, _mm512_load_ps(table))};
  };
  const FullVec less =
      hn::MulAdd(hn::MulAdd(of_step(kSquare), a, of_step(kLinear)), a, of_step(kConstant));
  return hn::Sub(hn::Max(hn::Zero(d), x), less);  // the second where x is not a number
}
#endif

// max(x, 0); where x is not a number, neither is this.
template <class D, class V>
HWY_INLINE V rectified(D d, V x) {
  return hn::IfThenElse(hn::Lt(x, hn::Zero(d)), hn::Zero(d), x);
}

// What is no number stays none: a sum that overflowed must not come out as some depth.
// kRough, beside narrow products: within 1e-4 and 5e-4 of the value; SiLU of whole AVX-512 vectors
// within 4e-4.
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
    return hn::Mul(x, reciprocal(d, hn::Add(one, exp_approx<-1>(d, x))));
  } else if constexpr (kActivation == Activation::kElu && kRough) {
    return hn::IfThenElse(hn::Lt(x, zero), hn::Sub(rough_exp_minus(d, hn::Abs(x)), one), x);
  } else if constexpr (kActivation == Activation::kElu) {
    return hn::IfThenElse(hn::Lt(x, zero), hn::Sub(exp_approx<1>(d, x), one), x);
  } else if constexpr (kActivation == Activation::kRelu) {
    return rectified(d, x);
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
