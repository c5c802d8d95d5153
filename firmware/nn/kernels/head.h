// The diffusion head: one evaluation with the sampler's update in one pass, and the way from logit
// to metres.
//
// conv1(condition + time + embed(state)) = conv1(condition) + conv1(time) + conv1(embed(state)):
// the first is the same for all steps and computed once; the last two are a constant and a 5x5
// convolution of a single channel. Both convolutions pad with zeros: what conv1 does not see beyond
// the border is missing from constant and taps of the pixels there, which so have their own.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "firmware/nn/network.h"

namespace lcdm::kernels {

// Where a pixel is, 3 * row + column: 0 in the first one, 2 in the last, 1 between.
inline constexpr int kHeadPlaces = 9;
// Whether conv1's tap 3 * ky + kx sees the image from there.
constexpr bool head_tap_sees(std::size_t place, std::size_t tap) {
  const auto sees = [](std::size_t at, std::size_t k) { return at == 1 || k != at; };
  return sees(place / 3, tap / 3) && sees(place % 3, tap % 3);
}

// What a sampler step's hidden layer is made of. Borrowed pointers; C = channels.
struct HeadStep {
  // conv1(condition) without bias, [height, width, C]; in halves each row's pixels two by two, as
  // RowOutput says.
  const float* shared = nullptr;
  const float* state = nullptr;  // [height, width]; null: zero everywhere
  int height = 0;                // at least 2, as the width
  int width = 0;
  int channels = 0;
  const float* scale = nullptr;     // [C]: the folded norm's factor
  const float* composed = nullptr;  // packed by pack_composed: scale * conv1(embed(.))
  const float* constant = nullptr;  // [kHeadPlaces, C]: bias + scale * conv1(time)
  bool relu = true;                 // false: a norm follows
  float* hidden = nullptr;          // [height, width, C]; null where nobody reads it
};

// What a head's step can be made in where `wanted` is asked for: floats, or halves that need no
// range (bfloat16) where the processor has them and one pixel's channels are one vector.
Precision head_precision(Precision wanted, int channels);
// As HeadStep and HeadUpdate want them, of taps [kHeadPlaces, 25, C] and [9, C].
std::vector<float> pack_composed(std::span<const float> taps, int channels, Precision precision);
std::vector<float> pack_update_weights(std::span<const float> taps, int channels,
                                       Precision precision);

// Computes rows [begin, end) of step.hidden; in floats.
void head_hidden_rows(const HeadStep& step, int begin, int end);

// next = p * state + q * (bias + conv3x3(hidden)), zero padding.
struct HeadUpdate {
  const float* hidden = nullptr;  // [height, width, C]; null: made from `step` row by row
  HeadStep step;                  // its sizes count in both cases
  // Of both convolutions and of the weights packed for them; floats where `hidden` is given.
  Precision precision = Precision::kFloat32;
  const float* weights = nullptr;  // packed by pack_update_weights
  float bias = 0;
  float p = 0;
  float q = 0;
  const float* state = nullptr;  // [height, width]
  float* next = nullptr;         // [height, width]
};

// Floats of scratch that head_update_rows needs.
std::size_t head_update_scratch(const HeadUpdate& update);

// Computes rows [begin, end).
void head_update_rows(const HeadUpdate& update, int begin, int end, float* scratch);

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
