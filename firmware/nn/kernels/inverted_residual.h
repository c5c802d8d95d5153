// MobileNetV2's block in one pass: expand, filter depthwise, project. The expanded image, by far
// the largest tensor of the encoder, exists only as three rows of a strip in the second cache.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "firmware/nn/kernels/matrix.h"

namespace lcdm::kernels {

// output = project(silu(depthwise3x3(silu(expand(input))))) + residual, zero padding. Borrowed
// pointers.
struct InvertedResidual {
  const float* input = nullptr;  // [height, width, channels]
  int height = 0;
  int width = 0;
  int channels = 0;
  int hidden = 0;  // channels in between
  int stride = 1;
  PackedMatrix expand;  // channels -> hidden
  // Of the expanded pixels and of the taps: floats, or beside narrow products kBfloat16.
  Precision filter = Precision::kFloat32;
  const float* taps = nullptr;       // packed by pack_filter_taps
  const float* taps_bias = nullptr;  // [hidden]
  PackedMatrix project;              // hidden -> project.columns
  const float* residual = nullptr;   // of the output's shape, or null
  float* output = nullptr;           // [height / stride, width / stride, project.columns]
  // Where tests want to see what is in between; null otherwise.
  float* expanded = nullptr;  // [height, width, hidden]
  float* filtered = nullptr;  // [height / stride, width / stride, hidden]

  int strip_columns() const;            // output columns that are computed together
  int window_words(int columns) const;  // pixels, or pairs of them, that so many of these look at
};

// Taps [9, hidden] as the filter wants them.
std::vector<float> pack_filter_taps(std::span<const float> taps, Precision filter);

// Floats of scratch that inverted_residual_rows needs.
std::size_t inverted_residual_scratch(const InvertedResidual& block);

// Computes output rows [begin, end).
void inverted_residual_rows(const InvertedResidual& block, int begin, int end, float* scratch);

}  // namespace lcdm::kernels
