// The arithmetic of bfloat16_silu.h, without LibTorch. Numbers are bfloat16's bits; results are
// rounded to nearest, ties to even, and what is no number stays none.
#pragma once

#include <cstdint>
#include <span>

namespace lcdm::model {

// y = x / (1 + e^-x), of as many numbers.
void bfloat16_silu(std::span<const std::uint16_t> x, std::span<std::uint16_t> y);

// dx = dy (s + x s (1 - s)) with s = 1 / (1 + e^-x), of as many numbers.
void bfloat16_silu_gradient(std::span<const std::uint16_t> x, std::span<const std::uint16_t> dy,
                            std::span<std::uint16_t> dx);

}  // namespace lcdm::model
