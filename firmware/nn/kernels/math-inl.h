// Vector mathematics shared by the kernels: once per instruction set, hence the odd guard.
#if defined(LCDM_KERNELS_MATH_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef LCDM_KERNELS_MATH_INL_H
#undef LCDM_KERNELS_MATH_INL_H
#else
#define LCDM_KERNELS_MATH_INL_H
#endif

#include <cstddef>

#include "firmware/nn/network.h"

#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using FullTag = HWY_FULL(float);
using FullVec = hn::Vec<FullTag>;

// e^x within 2e-7 relative for x in [-87, 88], clamped outside: Cephes' expf (2^n times a
// polynomial of the remainder).
template <class D, class V>
HWY_INLINE V exp_approx(D d, V x) {
  const hn::RebindToSigned<D> di;
  x = hn::Min(hn::Max(x, hn::Set(d, -87.0F)), hn::Set(d, 88.0F));
  const V n = hn::Round(hn::Mul(x, hn::Set(d, 1.44269504F)));
  V r = hn::NegMulAdd(n, hn::Set(d, 0.693359375F), x);
  r = hn::NegMulAdd(n, hn::Set(d, -2.12194440e-4F), r);
  V p = hn::Set(d, 1.9875691500e-4F);
  p = hn::MulAdd(p, r, hn::Set(d, 1.3981999507e-3F));
  p = hn::MulAdd(p, r, hn::Set(d, 8.3334519073e-3F));
  p = hn::MulAdd(p, r, hn::Set(d, 4.1665795894e-2F));
  p = hn::MulAdd(p, r, hn::Set(d, 1.6666665459e-1F));
  p = hn::MulAdd(p, r, hn::Set(d, 5.0000001201e-1F));
  p = hn::MulAdd(p, hn::Mul(r, r), hn::Add(r, hn::Set(d, 1.0F)));
  const auto exponent = hn::Add(hn::ConvertTo(di, n), hn::Set(di, 127));
  return hn::Mul(p, hn::BitCast(d, hn::ShiftLeft<23>(exponent)));
}

template <class D, class V>
HWY_INLINE V activate(D d, Activation activation, V x) {
  const V zero = hn::Zero(d);
  const V one = hn::Set(d, 1.0F);
  switch (activation) {
    case Activation::kNone:
      return x;
    case Activation::kSilu:
      return hn::Div(x, hn::Add(one, exp_approx(d, hn::Sub(zero, x))));
    case Activation::kElu:
      return hn::IfThenElse(hn::Gt(x, zero), x, hn::Sub(exp_approx(d, x), one));
    case Activation::kRelu:
      return hn::Max(x, zero);
  }
  return x;
}

// Calls f(tag, first) for consecutive runs of channels: whole vectors, then fours, then single
// ones, each with a tag of that many lanes.
template <class F>
HWY_INLINE void for_channels(std::size_t channels, F&& f) {
  const FullTag full;
  const HWY_CAPPED(float, 4) four;
  const HWY_CAPPED(float, 1) one;
  std::size_t c = 0;
  for (; c + hn::Lanes(full) <= channels; c += hn::Lanes(full)) f(full, c);
  for (; c + hn::Lanes(four) <= channels; c += hn::Lanes(four)) f(four, c);
  for (; c < channels; ++c) f(one, c);
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#endif
