// What tests of 3x3 convolutions are put together from.
#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <vector>

#include "firmware/nn/kernels/conv.h"
#include "firmware/nn/kernels/words.h"
#include "tests/firmware/image.h"

namespace lcdm::kernels {

inline Image upsampled(const Image& in, Upsampling how) {
  if (how == Upsampling::kNone) return in;
  Image out{in.height * 2, in.width * 2, in.channels, {}};
  for (int y = 0; y < out.height; ++y) {
    for (int x = 0; x < out.width; ++x) {
      for (int c = 0; c < in.channels; ++c) {
        if (how == Upsampling::kNearest) {
          out.values.push_back(in.at(y / 2, x / 2, c));
          continue;
        }
        const auto blend = [&](int row) {
          const int other = std::clamp(x / 2 + (x % 2 == 0 ? -1 : 1), 0, in.width - 1);
          return 0.75 * in.at(row, x / 2, c) + 0.25 * in.at(row, other, c);
        };
        const int other = std::clamp(y / 2 + (y % 2 == 0 ? -1 : 1), 0, in.height - 1);
        out.values.push_back(0.75 * blend(y / 2) + 0.25 * blend(other));
      }
    }
  }
  return out;
}

// The direct convolution of the channels after the first `skipped`.
inline PackedMatrix without(const Filter& filter, int skipped, std::vector<float>& store,
                            Precision precision = Precision::kFloat32) {
  const int used = filter.channels - skipped;
  const int runs = precision == Precision::kFloat32 ? 1 : 3;
  store.resize(packed_floats(used * 9, filter.columns, precision, runs));
  return pack_matrix(
      used * 9, filter.columns,
      [&](int k, int n) { return filter.at(n, skipped + k % used, k / used); }, filter.bias, store,
      precision, runs);
}

// The first `count` channels, tap by tap.
inline PackedMatrix taps_of(const Filter& filter, int count, std::vector<float>& store,
                            Precision precision = Precision::kFloat32) {
  store.resize(packed_floats(count, 9 * filter.columns, precision));
  return pack_matrix(
      count, 9 * filter.columns,
      [&](int k, int n) { return filter.at(n % filter.columns, k, n / filter.columns); }, {}, store,
      precision);
}

inline void expect_convolved(const Image& in, const Filter& filter, const Conv3x3& conv,
                             const std::vector<float>& out) {
  expect_near(out, filter.of(in, conv.stride, conv.padding), 4e-6 * 9 * (in.channels + 4));
}

inline ConvInput as_input(const Image& image, const std::vector<float>& values,
                          Upsampling upsampling) {
  return {values.data(), image.height, image.width, image.channels, upsampling};
}

// A convolution of an image in memory; weights and output are the caller's.
inline Conv3x3 conv_of(const Image& image, const std::vector<float>& values,
                       Padding padding = Padding::kZero) {
  Conv3x3 conv;
  conv.inputs[0] = as_input(image, values, Upsampling::kNone);
  conv.height = image.height;
  conv.width = image.width;
  conv.channels = image.channels;
  conv.padding = padding;
  return conv;
}

// Its rows in two calls, the later ones first.
inline void convolve_in_two(const Conv3x3& conv) {
  const ConvChain chain = {{conv}, 1};
  std::vector<float> scratch(conv3x3_scratch(chain));
  const int rows = conv.height / conv.stride;
  conv3x3_rows(chain, rows / 2, rows, scratch.data());
  conv3x3_rows(chain, 0, rows / 2, scratch.data());
}

// Pixels [height, columns] two by two, as RowOutput says, are these, [height, width, columns].
inline void expect_in_pairs(const std::vector<float>& words, const Image& want) {
  const int pairs = (want.width + 1) / 2;
  for (int y = 0; y < want.height; ++y) {
    for (int x = 0; x < want.width; ++x) {
      for (int n = 0; n < want.channels; ++n) {
        const int at = (y * pairs + x / 2) * want.channels + n;
        const auto word = std::bit_cast<std::uint32_t>(words[static_cast<std::size_t>(at)]);
        const float got = x % 2 == 0 ? bfloat16_first(word) : bfloat16_second(word);
        const double pixel = want.at(y, x, n);
        ASSERT_NEAR(got, pixel, 2e-3 + std::fabs(pixel) / 256) << y << ", " << x << ", " << n;
      }
    }
  }
}

}  // namespace lcdm::kernels
