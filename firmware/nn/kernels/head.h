// The head's last convolution with the sampler's update, and the way from logit to metres.
#pragma once

namespace lcdm::kernels {

// next = p * state + q * (bias + conv3x3(h)), zero padding.
struct Update {
  const float* h = nullptr;  // [height, width, channels]
  int height = 0;
  int width = 0;
  int channels = 0;
  const float* weights = nullptr;  // [9, channels]
  float bias = 0;
  float p = 0;
  float q = 0;
  const float* state = nullptr;  // [height, width]
  float* next = nullptr;         // [height, width]
};

// Computes rows [begin, end).
void update_rows(const Update& update, int begin, int end);

// metres = scale / (0.01 + 9.99 * sigmoid(state * deviation + mean)).
struct ToDepth {
  const float* state = nullptr;  // [count]
  float deviation = 1;
  float mean = 0;
  float scale = 1;          // fx of the network's input / canonical focal length
  float* metres = nullptr;  // [count]
};

// Computes values [begin, end).
void depth_range(const ToDepth& depth, int begin, int end);

}  // namespace lcdm::kernels
