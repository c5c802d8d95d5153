// 3x3 convolutions to few channels with two thirds of the multiplications: Winograd's F(2, 3)
// (arXiv 1509.09308) along the rows. Of the three taps g of one kernel row and the four inputs d
// that two neighbouring pixels see,
//
//     y0 = m0 + m1 + m2,  y1 = m1 - m2 + m3,  where
//     m0 = (d0 - d2) g0,  m1 = (d1 + d2) (g0 + g1 + g2) / 2,
//     m3 = (d3 - d1) g2,  m2 = (d2 - d1) (g0 - g1 + g2) / 2:
//
// four products for six. Its transforms are a few additions, and where neighbouring pixels are
// alike it is as exact as the plain sum, so halves can follow it, as they cannot F(4x4, 3x3).
#pragma once

#include <cstddef>
#include <functional>
#include <span>

#include "firmware/nn/kernels/matrix.h"

namespace lcdm::kernels {

inline constexpr int kRowProducts = 4;  // of a pair of pixels and one kernel row
// The most that it is made for.
inline constexpr int kRowWinogradChannels = 32;
inline constexpr int kRowWinogradColumns = 16;
inline constexpr int kRowWinogradNotLanes = 8;  // vectors that it is not made for: AVX2's

// Whether it saves time, in sums of that precision, for so many channels in and out.
bool row_winograd_pays(int stride, int channels, int columns, Precision precision);

// Words of a transformed row of `width` pixels that had `pixel` words each. A pair of pixels has
// those of d1 + d2, d2 - d1, d0 - d2 and d3 - d1, in this order.
constexpr std::size_t row_winograd_words(int width, std::size_t pixel) {
  return static_cast<std::size_t>((width + 1) / 2) * kRowProducts * pixel;
}

// Numbers of a column, as packed_floats asks for; in three runs.
constexpr int row_winograd_depth(int channels) { return 3 * kRowProducts * channels; }

// The matrix for such rows, from weight(c, n, tap), tap = 3 * ky + kx; transformed in double.
PackedMatrix pack_row_winograd(int channels, int columns,
                               const std::function<float(int, int, int)>& weight,
                               std::span<const float> bias, std::span<float> out,
                               Precision precision);

}  // namespace lcdm::kernels
