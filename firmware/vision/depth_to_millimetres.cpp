#include "firmware/vision/depth_to_millimetres.h"

#include <cstddef>

#include "firmware/base/check.h"

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "firmware/vision/depth_to_millimetres.cpp"
#include "firmware/base/simd.h"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace lcdm {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

constexpr float kFarthest = 65535;

std::uint16_t convert_one(float metres) {
  const float rounded = metres * 1000.0F + 0.5F;
  if (!(rounded >= 1.0F)) return 0;  // also NaN
  return rounded < kFarthest ? static_cast<std::uint16_t>(rounded) : std::uint16_t{65535};
}

void convert(const float* metres, std::size_t count, std::uint16_t* millimetres) {
  const HWY_FULL(float) d;
  const hn::Rebind<std::int32_t, decltype(d)> whole;
  const hn::Rebind<std::uint16_t, decltype(d)> narrow;
  const auto one = hn::Set(d, 1.0F);
  std::size_t i = 0;
  for (; i + hn::Lanes(d) <= count; i += hn::Lanes(d)) {
    const auto rounded =
        hn::MulAdd(hn::LoadU(d, metres + i), hn::Set(d, 1000.0F), hn::Set(d, 0.5F));
    const auto valid = hn::IfThenElseZero(hn::Ge(rounded, one), rounded);  // NaN is not
    const auto bounded = hn::Min(valid, hn::Set(d, kFarthest));
    hn::StoreU(hn::DemoteTo(narrow, hn::ConvertTo(whole, bounded)), narrow, millimetres + i);
  }
  for (; i < count; ++i) millimetres[i] = convert_one(metres[i]);
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm {

HWY_EXPORT(convert);

void depth_to_millimetres(std::span<const float> metres,
                          std::span<std::uint16_t> millimetres) noexcept {
  LCDM_CHECK(metres.size() == millimetres.size());
  HWY_DYNAMIC_DISPATCH(convert)(metres.data(), metres.size(), millimetres.data());
}

}  // namespace lcdm
#endif  // HWY_ONCE
