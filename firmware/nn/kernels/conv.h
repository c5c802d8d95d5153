// 3x3 convolutions, from rows that are padded, upsampled, concatenated or fused while they are
// read.
#pragma once

#include <array>
#include <cstddef>

#include "firmware/nn/kernels/matrix.h"

namespace lcdm::kernels {

// An image [height, width, channels]; upsampling doubles both sides while it is read.
struct ConvInput {
  const float* data = nullptr;
  int height = 0;
  int width = 0;
  int channels = 0;
  Upsampling upsampling = Upsampling::kNone;
};

// Turns the one input, the condition [H, W, C], into condition + bias + conv3x3(state).
struct Embedding {
  const float* state = nullptr;    // [H, W], zero outside; null: no embedding
  const float* weights = nullptr;  // [9, C]
  const float* bias = nullptr;     // [C]: the convolution's and the time's together
};

// A convolution with all it reads and writes; borrowed pointers.
struct Conv3x3 {
  std::array<ConvInput, 2> inputs;  // concatenated along the channels
  int input_count = 1;
  Embedding embedding;
  int height = 0;  // of the input after upsampling
  int width = 0;
  int channels = 0;  // of all inputs together
  int stride = 1;
  Padding padding = Padding::kZero;
  PackedMatrix weights;  // k = (3 * ky + kx) * channels + c
  Activation activation = Activation::kNone;
  float* output = nullptr;  // [height / stride, width / stride, weights.columns]
};

// Floats of scratch that conv3x3_rows needs: a ring of three padded input rows.
std::size_t conv3x3_scratch(const Conv3x3& conv);

// Computes output rows [begin, end).
void conv3x3_rows(const Conv3x3& conv, int begin, int end, float* scratch);

// Depthwise 3x3 with zero padding and SiLU.
struct Depthwise3x3 {
  const float* input = nullptr;  // [height, width, channels]
  int height = 0;
  int width = 0;
  int channels = 0;
  int stride = 1;
  const float* weights = nullptr;  // [9, channels]
  const float* bias = nullptr;     // [channels]
  float* output = nullptr;         // [height / stride, width / stride, channels]
};

void depthwise3x3_rows(const Depthwise3x3& conv, int begin, int end);

}  // namespace lcdm::kernels
