// Normalisation: over the channels of a token, or over groups of channels of a whole image.
#pragma once

#include <cstddef>

#include "firmware/nn/network.h"

namespace lcdm::kernels {

struct LayerNorm {
  const float* input = nullptr;  // [rows, channels]
  int channels = 0;
  const float* weight = nullptr;  // [channels]
  const float* bias = nullptr;    // [channels]
  float epsilon = 0;
  float* output = nullptr;  // [rows, channels]
};

// Computes rows [begin, end).
void layer_norm_rows(const LayerNorm& norm, int begin, int end);

struct GroupNorm {
  const float* input = nullptr;  // [height, width, channels]
  int height = 0;
  int width = 0;
  int channels = 0;
  int groups = 0;
  const float* weight = nullptr;  // [channels]
  const float* bias = nullptr;    // [channels]
  float epsilon = 0;
  Activation activation = Activation::kNone;
  float* row_moments = nullptr;  // [height, 2, channels]: each row's mean and variance; between the
                                 // phases
  float* output = nullptr;       // [height, width, channels]
};

// Phase one, rows [begin, end); phase two needs all of its rows. These are added up row by row
// in double, so the result does not depend on how rows were shared out.
void group_norm_moments(const GroupNorm& norm, int begin, int end);
void group_norm_apply(const GroupNorm& norm, int begin, int end);

}  // namespace lcdm::kernels
