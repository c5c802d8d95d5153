// 32-bit words of narrow numbers, one at a time: for packing, and for the ends of rows.
#pragma once

#include <algorithm>
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

// The numbers of such a pair.
inline float bfloat16_first(std::uint32_t pair) { return std::bit_cast<float>(pair << 16); }
inline float bfloat16_second(std::uint32_t pair) {
  return std::bit_cast<float>(pair & 0xFFFF0000U);
}

// IEEE half precision: rounded to nearest, ties to even; beyond 65504 infinite, and what is no
// number stays none.
inline std::uint32_t float16_bits(float x) {
  const auto all = std::bit_cast<std::uint32_t>(x);
  const std::uint32_t sign = (all >> 16) & 0x8000U;
  const std::uint32_t bits = all & 0x7FFFFFFFU;
  if (bits >= 0x47800000U) return sign | (bits > 0x7F800000U ? 0x7E00U : 0x7C00U);  // 65536
  if (bits >= 0x38800000U) {  // 2^-14, the least normal one
    return sign | ((bits + 0xFFFU + ((bits >> 13) & 1U) - (112U << 23)) >> 13);
  }
  // Subnormal ones are whole multiples of 2^-24, as the floats from .5 on are.
  const float moved = std::bit_cast<float>(bits) + 0.5F;
  return sign | (std::bit_cast<std::uint32_t>(moved) - std::bit_cast<std::uint32_t>(0.5F));
}

inline std::uint32_t float16_pair(float first, float second) {
  return float16_bits(first) | float16_bits(second) << 16;
}

struct PowerOfTwo {
  float value = 1;
  float inverse = 1;
};

// The largest that is not more than x, at most 2^126, whose inverse is a normal float too; so
// x * inverse is from 1 to 2, of the largest floats to 4. Where x has none among the normal floats
// the value is 0, and x counts as that.
inline PowerOfTwo power_of_two_within(float x) {
  constexpr std::uint32_t kMost = 253U << 23;
  const std::uint32_t exponent = std::min(std::bit_cast<std::uint32_t>(x) & 0x7F800000U, kMost);
  return {std::bit_cast<float>(exponent), std::bit_cast<float>(0x7F000000U - exponent)};
}

}  // namespace lcdm::kernels
