// 32-bit words of narrow numbers, one at a time: for packing, and for the ends of rows.
#pragma once

#include <bit>
#include <cstdint>

namespace lcdm::kernels {

// Rounded to nearest, ties to even; finite numbers only.
inline std::uint32_t bfloat16_bits(float x) {
  const auto bits = std::bit_cast<std::uint32_t>(x);
  return (bits + 0x7FFFU + ((bits >> 16) & 1U)) >> 16;
}

// What has the smaller k lies in the lower half.
inline std::uint32_t bfloat16_pair(float first, float second) {
  return bfloat16_bits(first) | bfloat16_bits(second) << 16;
}

}  // namespace lcdm::kernels
