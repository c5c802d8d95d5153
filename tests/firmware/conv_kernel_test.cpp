// Convolutions, reshaping and the head's arithmetic against loops one can check by eye.
#include <algorithm>
#include <cmath>
#include <gtest/gtest.h>

#include "firmware/nn/kernels/conv.h"
#include "firmware/nn/kernels/head.h"
#include "firmware/nn/kernels/reshape.h"
#include "tests/firmware/isa.h"

namespace lcdm::kernels {
namespace {

using test::for_each_isa;
using test::Random;

// A channels-last image of doubles.
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

Image make_image(Random& random, int height, int width, int channels) {
  Image image{height, width, channels, {}};
  for (int i = 0; i < height * width * channels; ++i) {
    image.values.push_back(static_cast<double>(random.real()));
  }
  return image;
}

std::vector<float> to_floats(const std::vector<double>& values) {
  return {values.begin(), values.end()};
}

Image upsampled(const Image& in, Upsampling how) {
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

Image joined(const Image& a, const Image& b) {
  Image out{a.height, a.width, a.channels + b.channels, {}};
  for (int y = 0; y < a.height; ++y) {
    for (int x = 0; x < a.width; ++x) {
      for (int c = 0; c < a.channels; ++c) out.values.push_back(a.at(y, x, c));
      for (int c = 0; c < b.channels; ++c) out.values.push_back(b.at(y, x, c));
    }
  }
  return out;
}

// weight(n, c, tap) as [columns][channels][9].
struct Filter {
  int columns;
  int channels;
  std::vector<float> weights;
  std::vector<float> bias;
  std::vector<float> packed_store;
  PackedMatrix packed;

  Filter(Random& random, int out_channels, int in_channels)
      : columns(out_channels),
        channels(in_channels),
        weights(random.reals(static_cast<std::size_t>(out_channels * in_channels * 9))),
        bias(random.reals(static_cast<std::size_t>(out_channels))),
        packed_store(packed_floats(in_channels * 9, out_channels)),
        packed(pack_matrix(
            in_channels * 9, out_channels,
            [&](int k, int n) {
              return static_cast<float>(at(n, k % in_channels, k / in_channels));
            },
            bias, packed_store)) {}
  double at(int n, int c, int tap) const {
    return static_cast<double>(weights[static_cast<std::size_t>((n * channels + c) * 9 + tap)]);
  }
};

void expect_convolved(const Image& in, const Filter& filter, const Conv3x3& conv,
                      const std::vector<float>& out) {
  std::size_t i = 0;
  for (int y = 0; y < in.height / conv.stride; ++y) {
    for (int x = 0; x < in.width / conv.stride; ++x) {
      for (int n = 0; n < filter.columns; ++n, ++i) {
        double sum = static_cast<double>(filter.bias[static_cast<std::size_t>(n)]);
        for (int t = 0; t < 9; ++t) {
          for (int c = 0; c < in.channels; ++c) {
            sum += filter.at(n, c, t) * in.padded(y * conv.stride + t / 3 - 1,
                                                  x * conv.stride + t % 3 - 1, c, conv.padding);
          }
        }
        ASSERT_NEAR(out[i], sum, 2e-6 * 9 * in.channels) << y << ", " << x << ", " << n;
      }
    }
  }
  ASSERT_EQ(i, out.size());
}

ConvInput as_input(const Image& image, const std::vector<float>& values, Upsampling upsampling) {
  return {values.data(), image.height, image.width, image.channels, upsampling};
}

// One or two random inputs through a random filter, in three slices as three workers would.
void check_conv(Random& random, const Image& first, Upsampling upsampling, int second_channels,
                int stride, Padding padding, int columns) {
  const auto first_values = to_floats(first.values);
  Image whole = upsampled(first, upsampling);
  Conv3x3 conv;
  conv.inputs[0] = as_input(first, first_values, upsampling);
  Image second;
  std::vector<float> second_values;
  if (second_channels > 0) {
    second = make_image(random, whole.height, whole.width, second_channels);
    second_values = to_floats(second.values);
    conv.inputs[1] = as_input(second, second_values, Upsampling::kNone);
    conv.input_count = 2;
    whole = joined(whole, second);
  }
  const Filter filter(random, columns, whole.channels);
  std::vector<float> out(
      static_cast<std::size_t>(whole.height / stride * (whole.width / stride) * columns));
  conv.height = whole.height;
  conv.width = whole.width;
  conv.channels = whole.channels;
  conv.stride = stride;
  conv.padding = padding;
  conv.weights = filter.packed;
  conv.output = out.data();
  std::vector<float> scratch(conv3x3_scratch(conv));
  const int rows = whole.height / stride;
  conv3x3_rows(conv, rows / 2, rows, scratch.data());
  conv3x3_rows(conv, 0, rows / 3, scratch.data());
  conv3x3_rows(conv, rows / 3, rows / 2, scratch.data());
  expect_convolved(whole, filter, conv, out);
}

TEST(Conv3x3Kernel, ConvolvesAnySizeStrideAndPadding) {
  for_each_isa([] {
    Random random(1);
    for (const Padding padding : {Padding::kZero, Padding::kReflect}) {
      for (const int channels : {1, 3, 8, 20}) {
        for (const int columns : {1, 8, 24, 50}) {
          const Image image = make_image(random, random.whole(2, 9), random.whole(2, 19), channels);
          check_conv(random, image, Upsampling::kNone, 0, 1, padding, columns);
          const Image even =
              make_image(random, 2 * random.whole(1, 5), 2 * random.whole(1, 9), channels);
          check_conv(random, even, Upsampling::kNone, 0, 2, padding, columns);
        }
      }
    }
  });
}

TEST(Conv3x3Kernel, UpsamplesAndConcatenatesWhileReading) {
  for_each_isa([] {
    Random random(2);
    for (const Upsampling how : {Upsampling::kNone, Upsampling::kNearest, Upsampling::kBilinear}) {
      for (const Padding padding : {Padding::kZero, Padding::kReflect}) {
        for (const int second : {0, 5, 16}) {
          const Image image =
              make_image(random, random.whole(2, 5), random.whole(2, 9), random.whole(1, 20));
          check_conv(random, image, how, second, 1, padding, 7);
        }
      }
    }
  });
}

TEST(Conv3x3Kernel, EmbedsTheStateIntoTheCondition) {
  for_each_isa([] {
    Random random(3);
    const Image condition = make_image(random, 5, 11, 12);
    const Image state = make_image(random, 5, 11, 1);
    const Filter filter(random, 6, condition.channels);
    const auto taps = random.reals(9 * 12);
    const auto bias = random.reals(12);
    Image fused = condition;
    for (int y = 0; y < 5; ++y) {
      for (int x = 0; x < 11; ++x) {
        for (int c = 0; c < 12; ++c) {
          double& v = fused.values[static_cast<std::size_t>((y * 11 + x) * 12 + c)];
          v += static_cast<double>(bias[static_cast<std::size_t>(c)]);
          for (int t = 0; t < 9; ++t) {
            v += static_cast<double>(taps[static_cast<std::size_t>(t * 12 + c)]) *
                 state.padded(y + t / 3 - 1, x + t % 3 - 1, 0, Padding::kZero);
          }
        }
      }
    }
    const auto condition_values = to_floats(condition.values);
    const auto state_values = to_floats(state.values);
    std::vector<float> out(5 * 11 * 6);
    Conv3x3 conv;
    conv.inputs[0] = as_input(condition, condition_values, Upsampling::kNone);
    conv.embedding = {state_values.data(), taps.data(), bias.data()};
    conv.height = 5;
    conv.width = 11;
    conv.channels = 12;
    conv.weights = filter.packed;
    conv.output = out.data();
    std::vector<float> scratch(conv3x3_scratch(conv));
    conv3x3_rows(conv, 0, 5, scratch.data());
    expect_convolved(fused, filter, conv, out);
  });
}

TEST(DepthwiseKernel, FiltersEachChannelAlone) {
  for_each_isa([] {
    Random random(4);
    for (const int stride : {1, 2}) {
      for (const int channels : {1, 8, 20, 48}) {
        const Image in =
            make_image(random, stride * random.whole(1, 6), stride * random.whole(1, 12), channels);
        const auto values = to_floats(in.values);
        const auto weights = random.reals(static_cast<std::size_t>(9 * channels));
        const auto bias = random.reals(static_cast<std::size_t>(channels));
        const int rows = in.height / stride;
        const int columns = in.width / stride;
        std::vector<float> out(static_cast<std::size_t>(rows * columns * channels));
        depthwise3x3_rows({values.data(), in.height, in.width, channels, stride, weights.data(),
                           bias.data(), out.data()},
                          0, rows);
        std::size_t i = 0;
        for (int y = 0; y < rows; ++y) {
          for (int x = 0; x < columns; ++x) {
            for (int c = 0; c < channels; ++c, ++i) {
              double sum = static_cast<double>(bias[static_cast<std::size_t>(c)]);
              for (int t = 0; t < 9; ++t) {
                sum += static_cast<double>(weights[static_cast<std::size_t>(t * channels + c)]) *
                       in.padded(y * stride + t / 3 - 1, x * stride + t % 3 - 1, c, Padding::kZero);
              }
              ASSERT_NEAR(out[i], sum / (1 + std::exp(-sum)), 1e-5) << y << ", " << x << ", " << c;
            }
          }
        }
      }
    }
  });
}

TEST(UpdateKernel, AddsTheLastConvolutionToTheState) {
  for_each_isa([] {
    Random random(5);
    for (const int channels : {4, 16, 20}) {
      const Image h = make_image(random, 4, 9, channels);
      const auto values = to_floats(h.values);
      const auto weights = random.reals(static_cast<std::size_t>(9 * channels));
      const auto state = random.reals(4 * 9);
      std::vector<float> next(4 * 9);
      update_rows({values.data(), 4, 9, channels, weights.data(), 0.25F, 1.5F, -0.5F, state.data(),
                   next.data()},
                  0, 4);
      for (int i = 0; i < 4 * 9; ++i) {
        double out = 0.25;
        for (int t = 0; t < 9; ++t) {
          for (int c = 0; c < channels; ++c) {
            out += static_cast<double>(weights[static_cast<std::size_t>(t * channels + c)]) *
                   h.padded(i / 9 + t / 3 - 1, i % 9 + t % 3 - 1, c, Padding::kZero);
          }
        }
        const auto at = static_cast<std::size_t>(i);
        ASSERT_NEAR(next[at], 1.5 * static_cast<double>(state[at]) - 0.5 * out, 1e-5) << i;
      }
    }
  });
}

TEST(DepthKernel, TurnsLogitsIntoMetresBetweenATenthAndAHundred) {
  for_each_isa([] {
    std::vector<float> state;
    for (float x = -30; x <= 30; x += 0.37F) state.push_back(x);
    state.push_back(-1e9F);
    state.push_back(1e9F);
    std::vector<float> metres(state.size());
    depth_range({state.data(), 2.0F, -1.0F, 3.0F, metres.data()}, 0,
                static_cast<int>(state.size()));
    for (std::size_t i = 0; i < state.size(); ++i) {
      const double logit = 2 * static_cast<double>(state[i]) - 1;
      const double expected = 3 / (0.01 + 9.99 / (1 + std::exp(-logit)));
      ASSERT_NEAR(static_cast<double>(metres[i]) / expected, 1, 1e-6) << state[i];
    }
  });
}

TEST(ReshapeKernel, UnfoldGroupsPixelsByTheirPlaceInThePatchAndFoldUndoesIt) {
  // Pixel values are 10 y + x; patches of 2x2 in a 4x6 image.
  std::vector<float> image;
  for (int y = 0; y < 4; ++y) {
    for (int x = 0; x < 6; ++x) image.push_back(static_cast<float>(10 * y + x));
  }
  std::vector<float> tokens(image.size());
  const Patches patches = {4, 6, 1};
  unfold_rows(patches, image.data(), tokens.data(), 0, 2);
  EXPECT_EQ(tokens, (std::vector<float>{0,  2,  4,  20, 22, 24,  // top left of each patch
                                        1,  3,  5,  21, 23, 25,  // top right
                                        10, 12, 14, 30, 32, 34,  // bottom left
                                        11, 13, 15, 31, 33, 35}));
  std::vector<float> back(image.size());
  fold_rows(patches, tokens.data(), back.data(), 0, 1);
  fold_rows(patches, tokens.data(), back.data(), 1, 2);
  EXPECT_EQ(back, image);
}

TEST(ReshapeKernel, ResizeInterpolatesBetweenPixelCentres) {
  // 3 to 4 columns: centres at -.125 (clamped), .625, 1.375, 2.125 (clamped).
  const std::vector<float> row = {0, 8, 16};
  std::vector<float> out(4);
  resize_rows({row.data(), 1, 3, 1, 4, 1, out.data()}, 0, 1);
  EXPECT_EQ(out, (std::vector<float>{0, 5, 11, 16}));
  // Down and up again keeps a constant image constant.
  const std::vector<float> flat(15 * 5 * 3, 2.5F);
  std::vector<float> up(16 * 6 * 3);
  resize_rows({flat.data(), 15, 5, 16, 6, 3, up.data()}, 0, 16);
  for (const float v : up) ASSERT_EQ(v, 2.5F);
}

}  // namespace
}  // namespace lcdm::kernels
