// Channels-last images of doubles and convolutions of them, for references one can check by eye.
#pragma once

#include <algorithm>
#include <cmath>
#include <gtest/gtest.h>
#include <vector>

#include "firmware/nn/kernels/matrix.h"
#include "firmware/nn/network.h"
#include "tests/firmware/isa.h"

namespace lcdm::test {

struct Image {
  int height = 0;
  int width = 0;
  int channels = 0;
  std::vector<double> values;

  double at(int y, int x, int c) const {
    return values[static_cast<std::size_t>((y * width + x) * channels + c)];
  }
  double padded(int y, int x, int c, Padding padding) const {
    if (padding == Padding::kReflect) return at(mirror(y, height), mirror(x, width), c);
    return y >= 0 && y < height && x >= 0 && x < width ? at(y, x, c) : 0;
  }
  static int mirror(int i, int size) { return i < 0 ? -i : (i >= size ? 2 * size - 2 - i : i); }
};

inline Image make_image(Random& random, int height, int width, int channels) {
  Image image{height, width, channels, {}};
  for (int i = 0; i < height * width * channels; ++i) {
    image.values.push_back(static_cast<double>(random.real()));
  }
  return image;
}

// Side by side along the channels.
inline Image joined(const Image& a, const Image& b) {
  Image out{a.height, a.width, a.channels + b.channels, {}};
  for (int y = 0; y < a.height; ++y) {
    for (int x = 0; x < a.width; ++x) {
      for (int c = 0; c < a.channels; ++c) out.values.push_back(a.at(y, x, c));
      for (int c = 0; c < b.channels; ++c) out.values.push_back(b.at(y, x, c));
    }
  }
  return out;
}

// The sums of a square kernel: weight(n, c, tap) with tap = side * ky + kx.
template <typename Weight>
Image convolved(const Image& in, int columns, int side, int stride, Padding padding,
                const Weight& weight) {
  Image out{in.height / stride, in.width / stride, columns, {}};
  for (int y = 0; y < out.height; ++y) {
    for (int x = 0; x < out.width; ++x) {
      for (int n = 0; n < columns; ++n) {
        double sum = 0;
        for (int t = 0; t < side * side; ++t) {
          for (int c = 0; c < in.channels; ++c) {
            sum += weight(n, c, t) * in.padded(y * stride + t / side - side / 2,
                                               x * stride + t % side - side / 2, c, padding);
          }
        }
        out.values.push_back(sum);
      }
    }
  }
  return out;
}

// A convolution with random weights, [columns][channels][taps], and biases.
struct Filter {
  int columns;
  int channels;
  int side;
  std::vector<float> weights;
  std::vector<float> bias;
  std::vector<float> packed_store;
  kernels::PackedMatrix packed;  // k = tap * channels + c

  Filter(Random& random, int out_channels, int in_channels, int of_side)
      : columns(out_channels),
        channels(in_channels),
        side(of_side),
        weights(random.reals(static_cast<std::size_t>(columns * channels * side * side))),
        bias(random.reals(static_cast<std::size_t>(columns))),
        packed_store(kernels::packed_floats(channels * side * side, columns)),
        packed(kernels::pack_matrix(
            channels * side * side, columns,
            [this](int k, int n) { return at(n, k % channels, k / channels); }, bias,
            packed_store)) {}

  // The same in another precision; `store` holds it.
  kernels::PackedMatrix narrow(Precision precision, std::vector<float>& store, int runs = 1) const {
    const int depth = channels * side * side;
    store.resize(kernels::packed_floats(depth, columns, precision, runs));
    return kernels::pack_matrix(
        depth, columns, [this](int k, int n) { return at(n, k % channels, k / channels); }, bias,
        store, precision, runs);
  }

  float at(int n, int c, int tap) const {
    return weights[static_cast<std::size_t>((n * channels + c) * side * side + tap)];
  }
  Image of(const Image& in, int stride = 1, Padding padding = Padding::kZero) const {
    Image out = convolved(in, columns, side, stride, padding, [this](int n, int c, int tap) {
      return static_cast<double>(at(n, c, tap));
    });
    for (std::size_t i = 0; i < out.values.size(); ++i) {
      out.values[i] += static_cast<double>(bias[i % bias.size()]);
    }
    return out;
  }
};

// Whole numbers that every narrow precision holds exactly, with sums it adds up exactly: inputs
// from 0 to 15, both in every pixel, and weights that are -1, 0 or 1.
inline void make_whole(Random& random, Image& image) {
  for (std::size_t i = 0; i < image.values.size(); ++i) {
    const std::size_t channel = i % static_cast<std::size_t>(image.channels);
    image.values[i] = channel == 0 ? 15 : channel == 1 ? 0 : random.whole(0, 15);
  }
}
inline void make_whole(Random& random, Filter& filter) {
  for (float& w : filter.weights) w = static_cast<float>(random.whole(-1, 1));
  for (float& b : filter.bias) b = static_cast<float>(random.whole(-9, 9));
}

// By how much a sum of so many numbers, each no larger than the image's, and rounded to that
// precision, may be off.
inline double rounding_of_sum(const Image& image, int numbers, Precision precision) {
  double largest = 0;
  for (const double v : image.values) largest = std::max(largest, std::fabs(v));
  const double step = precision == Precision::kInt8 ? 1.0 / 255 : 1.0 / 512;
  return 2 * largest * step * std::sqrt(numbers);
}

inline std::vector<float> to_floats(const std::vector<double>& values) {
  return {values.begin(), values.end()};
}
inline void expect_near(const std::vector<float>& got, const Image& want, double tolerance) {
  ASSERT_EQ(got.size(), want.values.size());
  for (std::size_t i = 0; i < got.size(); ++i) ASSERT_NEAR(got[i], want.values[i], tolerance) << i;
}

// What a kernel has not stored; a kernel's rows [begin, end) of rows of `pitch` floats are the only
// ones that are not so.
constexpr float kUntouched = 12345;
inline void expect_only_rows(const std::vector<float>& got, std::size_t pitch, std::size_t begin,
                             std::size_t end) {
  for (std::size_t i = 0; i < got.size(); ++i) {
    const bool own = i / pitch >= begin && i / pitch < end;
    ASSERT_EQ(got[i] != kUntouched, own) << "row " << i / pitch;
  }
}

}  // namespace lcdm::test

// The tests of kernels write these without a prefix.
namespace lcdm::kernels {
using test::convolved;
using test::expect_near;
using test::expect_only_rows;
using test::Filter;
using test::for_each_isa;
using test::for_each_narrow;
using test::Image;
using test::joined;
using test::kUntouched;
using test::make_image;
using test::make_whole;
using test::Random;
using test::rounding_of_sum;
using test::to_floats;
}  // namespace lcdm::kernels
