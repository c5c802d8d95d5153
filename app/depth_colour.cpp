#include "app/depth_colour.h"

#include <algorithm>
#include <cmath>

#include "firmware/base/check.h"

namespace lcdm {
namespace {

// How much of the way to the target one frame goes.
constexpr float kApproach = 0.25F;  // half a second at 8 frames/s, the least we expect
// So that a flat wall is not shown as noise in all colours.
constexpr float kLeastRatio = 1.5F;

std::uint8_t to_byte(float x) {
  return static_cast<std::uint8_t>(std::lround(255 * std::clamp(x, 0.0F, 1.0F)));
}

}  // namespace

Rgb turbo(float x) {
  x = std::clamp(x, 0.0F, 1.0F);
  const auto polynomial = [x](const std::array<float, 6>& c) {
    return c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * (c[4] + x * c[5]))));
  };
  return {to_byte(polynomial({0.13572138F, 4.61539260F, -42.66032258F, 132.13108234F,
                              -152.94239396F, 59.28637943F})),
          to_byte(polynomial(
              {0.09140261F, 2.19418839F, 4.84296658F, -14.18503333F, 4.27729857F, 2.82956604F})),
          to_byte(polynomial({0.10667330F, 12.64194608F, -60.58204836F, 110.36276771F,
                              -89.90310912F, 27.34824973F}))};
}

std::optional<DepthRange> range_of(std::span<const std::uint16_t> depth) {
  // Steps of 64 mm are fine enough for the ends of a colour map.
  constexpr int kShift = 6;
  std::array<std::uint32_t, (65536 >> kShift)> counts{};
  std::uint32_t valid = 0;
  for (const std::uint16_t value : depth) {
    if (value == 0) continue;
    ++counts[value >> kShift];
    ++valid;
  }
  if (valid == 0) return std::nullopt;
  const auto quantile = [&](double part) {
    auto left = static_cast<std::uint32_t>(part * (valid - 1));
    std::size_t bin = 0;
    while (left >= counts[bin]) left -= counts[bin++];
    const std::size_t middle = (bin << kShift) + (std::size_t{1} << (kShift - 1));
    return static_cast<float>(middle);
  };
  const float nearest = quantile(0.02);
  return DepthRange{nearest, std::max(quantile(0.98), nearest * kLeastRatio)};
}

DepthRange approach(const DepthRange& range, const DepthRange& target) {
  const auto blend = [](float from, float to) { return from * std::pow(to / from, kApproach); };
  return {blend(range.nearest, target.nearest), blend(range.farthest, target.farthest)};
}

void DepthColour::set_range(const DepthRange& range) {
  LCDM_CHECK(range.nearest > 0 && range.farthest > range.nearest);
  range_ = range;
  const float span = std::log(range.farthest / range.nearest);
  for (std::size_t value = 1; value < table_.size(); ++value) {
    const float x = std::log(static_cast<float>(value) / range.nearest) / span;
    table_[value] = turbo(1 - x);
  }
}

void DepthColour::paint(std::span<const std::uint16_t> depth, std::span<std::uint8_t> rgb) const {
  LCDM_CHECK(rgb.size() == depth.size() * 3);
  std::uint8_t* out = rgb.data();
  for (const std::uint16_t value : depth) {
    const Rgb colour = table_[value];
    *out++ = colour.r;
    *out++ = colour.g;
    *out++ = colour.b;
  }
}

}  // namespace lcdm
