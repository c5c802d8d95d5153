// Multi-head attention without an N x N tensor.
#pragma once

#include <cstddef>

#include "firmware/nn/network.h"

namespace lcdm::kernels {

// softmax(q k^T / sqrt(channels / heads)) v for each position and head (NETWORK.md, "Encoder").
struct Attention {
  const float* qkv = nullptr;  // [positions, tokens, 3 * channels]: q, k, v, each split into heads
  int positions = 0;
  int tokens = 0;
  int channels = 0;
  int heads = 0;
  float* output = nullptr;                    // [positions, tokens, channels]
  Precision precision = Precision::kFloat32;  // or half, where channels / heads is even
};

// The work is cut into items: one tile of queries of one head of one position each.
int attention_items(const Attention& attention);

// Floats of scratch for attention_range.
std::size_t attention_scratch(const Attention& attention);

// Computes items [begin, end).
void attention_range(const Attention& attention, int begin, int end, float* scratch);

}  // namespace lcdm::kernels
