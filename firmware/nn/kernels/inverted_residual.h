// MobileNetV2's block in one pass: expand, filter depthwise, project. The expanded image, by far
// the largest tensor of the encoder, exists only as three rows of a strip in the second cache.
#pragma once

#include <cstddef>

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
  PackedMatrix expand;               // channels -> hidden
  const float* taps = nullptr;       // [9, hidden]
  const float* taps_bias = nullptr;  // [hidden]
  PackedMatrix project;              // hidden -> project.columns
  const float* residual = nullptr;   // of the output's shape, or null
  float* output = nullptr;           // [height / stride, width / stride, project.columns]
  // Where tests want to see what is in between; null otherwise.
  float* expanded = nullptr;  // [height, width, hidden]
  float* filtered = nullptr;  // [height / stride, width / stride, hidden]

  int strip_columns() const;              // output columns that are computed together
  int window_columns(int columns) const;  // expanded pixels that so many output columns look at
};

// Floats of scratch that inverted_residual_rows needs.
std::size_t inverted_residual_scratch(const InvertedResidual& block);

// Computes output rows [begin, end).
void inverted_residual_rows(const InvertedResidual& block, int begin, int end, float* scratch);

}  // namespace lcdm::kernels
