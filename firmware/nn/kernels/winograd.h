// 3x3 convolutions of stride 1 with a quarter of the multiplications: Winograd's F(4x4, 3x3)
// (arXiv 1509.09308), for layers with enough channels to pay for its transforms.
#pragma once

#include <cstddef>
#include <functional>
#include <span>

#include "firmware/nn/kernels/conv.h"

namespace lcdm::kernels {

inline constexpr int kWinogradTile = 4;       // output pixels of a tile, each way
inline constexpr int kWinogradProducts = 36;  // of a 6x6 input tile, each with a matrix of its own

struct WinogradConv {
  ConvChain before = {{}, 0};     // makes the input row by row; count 0: it is in memory
  Conv3x3 conv;                   // but for its weights, of which only the bias counts
  const float* panels = nullptr;  // kWinogradProducts packed matrices, packed_floats() apart
};

// Whether the transforms pay at this size, beside direct sums in that precision.
bool winograd_pays(const Conv3x3& conv, int columns, Precision direct = Precision::kFloat32);

// Floats of the panels.
std::size_t winograd_floats(int channels, int columns);
// weight(c, n, tap), tap = 3 * ky + kx; transformed in double.
void pack_winograd(int channels, int columns, const std::function<float(int, int, int)>& weight,
                   std::span<float> out);

// Floats of scratch that winograd_rows needs.
std::size_t winograd_scratch(const WinogradConv& conv);

// Computes output rows [begin, end); begin is a multiple of kWinogradTile, so that the tiles are
// the same however rows are shared out.
void winograd_rows(const WinogradConv& conv, int begin, int end, float* scratch);

}  // namespace lcdm::kernels
