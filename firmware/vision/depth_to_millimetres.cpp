#include "firmware/vision/depth_to_millimetres.h"

#include <cstddef>

#include "firmware/base/check.h"

namespace lcdm {
namespace {

std::uint16_t convert(float metres) {
  const float rounded = metres * 1000.0F + 0.5F;
  if (!(rounded >= 1.0F)) return 0;  // also NaN
  return rounded < 65535.0F ? static_cast<std::uint16_t>(rounded) : std::uint16_t{65535};
}

}  // namespace

void depth_to_millimetres(std::span<const float> metres,
                          std::span<std::uint16_t> millimetres) noexcept {
  LCDM_CHECK(metres.size() == millimetres.size());
  for (std::size_t i = 0; i < metres.size(); ++i) millimetres[i] = convert(metres[i]);
}

}  // namespace lcdm
