// Depth as it leaves the camera: metres to 16-bit millimetres.
#pragma once

#include <cstdint>
#include <span>

namespace lcdm {

// Rounded to the nearest millimetre; 0 for what is not a positive number, 65535 at or beyond
// 65.535 m. Both have the same size.
void depth_to_millimetres(std::span<const float> metres,
                          std::span<std::uint16_t> millimetres) noexcept;

}  // namespace lcdm
