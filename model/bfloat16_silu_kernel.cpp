#include "model/bfloat16_silu_kernel.h"

#include <cstddef>

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "model/bfloat16_silu_kernel.cpp"
#include "firmware/base/simd.h"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
#include "firmware/nn/kernels/math-inl.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace lcdm::model {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

template <class D>
HWY_INLINE hn::Vec<D> load(D d, const std::uint16_t* from) {
  const hn::Rebind<std::uint16_t, D> half;
  const hn::RebindToUnsigned<D> word;
  return hn::BitCast(d, hn::ShiftLeft<16>(hn::PromoteTo(word, hn::LoadU(half, from))));
}

template <class D>
HWY_INLINE void store([[maybe_unused]] D d, hn::Vec<D> v, std::uint16_t* to) {
  const hn::Rebind<std::uint16_t, D> half;
  const hn::RebindToUnsigned<D> word;
  const hn::RebindToSigned<D> whole;
  const auto bits = hn::BitCast(word, v);
  const auto odd = hn::And(hn::ShiftRight<16>(bits), hn::Set(word, 1));
  const auto nearest = hn::Add(bits, hn::Add(odd, hn::Set(word, 0x7FFF)));
  // Of what is no number the rounding could make one.
  const auto none = hn::Or(bits, hn::Set(word, 0x00400000));
  const auto kept = hn::IfThenElse(hn::RebindMask(word, hn::Eq(v, v)), nearest, none);
  hn::StoreU(hn::DemoteTo(half, hn::BitCast(whole, hn::ShiftRight<16>(kept))), half, to);
}

template <class D, class V = hn::Vec<D>>
HWY_INLINE V sigmoid(D d, V x) {
  const V one = hn::Set(d, 1.0F);
  return hn::Div(one, hn::Add(one, kernels::HWY_NAMESPACE::exp_approx<-1>(d, x)));
}

// At every place `at` of `count`: a vector as long as possible, then single numbers.
template <class Function>
HWY_INLINE void for_all(std::size_t count, const Function& function) {
  const kernels::HWY_NAMESPACE::FullTag d;
  constexpr std::size_t kLanes = kernels::HWY_NAMESPACE::kLanes;
  std::size_t at = 0;
  for (; at + kLanes <= count; at += kLanes) function(d, at);
  for (; at < count; ++at) function(HWY_CAPPED(float, 1)(), at);
}

void forward(const std::uint16_t* x, std::size_t count, std::uint16_t* y) {
  for_all(count, [&](auto d, std::size_t at) HWY_ATTR {
    const auto v = load(d, x + at);
    store(d, hn::Mul(v, sigmoid(d, v)), y + at);
  });
}

void backward(const std::uint16_t* x, const std::uint16_t* dy, std::size_t count,
              std::uint16_t* dx) {
  for_all(count, [&](auto d, std::size_t at) HWY_ATTR {
    const auto v = load(d, x + at);
    const auto s = sigmoid(d, v);
    const auto rest = hn::NegMulAdd(v, s, v);  // x (1 - s)
    store(d, hn::Mul(load(d, dy + at), hn::MulAdd(s, rest, s)), dx + at);
  });
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::model
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm::model {

HWY_EXPORT(forward);
HWY_EXPORT(backward);

void bfloat16_silu(std::span<const std::uint16_t> x, std::span<std::uint16_t> y) {
  HWY_DYNAMIC_DISPATCH(forward)(x.data(), x.size(), y.data());
}

void bfloat16_silu_gradient(std::span<const std::uint16_t> x, std::span<const std::uint16_t> dy,
                            std::span<std::uint16_t> dx) {
  HWY_DYNAMIC_DISPATCH(backward)(x.data(), dy.data(), x.size(), dx.data());
}

}  // namespace lcdm::model
#endif  // HWY_ONCE
