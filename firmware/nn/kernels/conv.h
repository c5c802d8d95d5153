// 3x3 convolutions, from rows that are padded, upsampled or concatenated while they are
// read; what is upsampled bilinearly is convolved before it is upsampled.
#pragma once

#include <array>
#include <cstddef>

#include "firmware/nn/kernels/matrix.h"

namespace lcdm::kernels {

// An image [height, width, channels]; upsampling to the nearest doubles both sides while it is
// read.
struct ConvInput {
  const float* data = nullptr;
  int height = 0;
  int width = 0;
  int channels = 0;
  Upsampling upsampling = Upsampling::kNone;  // or kNearest
};

// An input that is doubled bilinearly, as its share of the convolution (upsampled-inl.h).
struct UpsampledShare {
  const float* data = nullptr;  // [height, width, channels] before upsampling; null: none
  int height = 0;
  int width = 0;
  int channels = 0;
  PackedMatrix taps;  // depth channels; column (3 * ky + kx) * columns of the convolution + n

  std::size_t scratch_floats() const;  // three rows of products
};

// A convolution with all it reads and writes; borrowed pointers.
struct Conv3x3 {
  UpsampledShare upsampled;         // added to what the inputs give; zero padding, stride 1 only
  std::array<ConvInput, 2> inputs;  // concatenated along the channels
  int input_count = 1;              // may be 0 beside an upsampled share
  int height = 0;                   // of the input after upsampling
  int width = 0;
  int channels = 0;  // of all inputs together
  int stride = 1;
  Padding padding = Padding::kZero;
  PackedMatrix weights;  // k = (3 * ky + kx) * channels + c; or pack_row_winograd's
  Activation activation = Activation::kNone;
  float* output = nullptr;  // [height / stride, width / stride, weights.columns]
  // The output's pixels two by two, as RowOutput says; of the last of a chain, in one product.
  bool paired = false;
  bool row_winograd = false;  // by Winograd's F(2, 3) along the rows (row_winograd.h)

  std::size_t output_row() const;  // floats, or words of pairs
  // A padded input row: as words of the weights' precision, and as floats before it is narrow or
  // transformed.
  std::size_t row_words() const;
  std::size_t whole_floats() const;    // 0 where it stays so
  std::size_t scratch_floats() const;  // rings of three rows of either kind of input
};

// Convolutions of which each reads only the one before, row by row as it makes them; the last one's
// output is stored, the others' only where they have one. All but the first pad with zeros (a
// reflected border would ask for rows out of order) and have one input, whose data is null.
struct ConvChain {
  static constexpr std::size_t kMost = 3;
  std::array<Conv3x3, kMost> convs;
  int count = 0;
};

// Floats of scratch that conv3x3_rows needs.
std::size_t conv3x3_scratch(const ConvChain& chain);

// Computes output rows [begin, end) of the last.
void conv3x3_rows(const ConvChain& chain, int begin, int end, float* scratch);

}  // namespace lcdm::kernels
