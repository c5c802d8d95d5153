// Convolutions, reshaping and the head's arithmetic against loops one can check by eye.
#include <algorithm>
#include <cmath>
#include <gtest/gtest.h>

#include "firmware/nn/kernels/conv.h"
#include "firmware/nn/kernels/head.h"
#include "firmware/nn/kernels/inverted_residual.h"
#include "firmware/nn/kernels/reshape.h"
#include "firmware/nn/kernels/winograd.h"
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
  // The direct convolution of the channels after the first `skipped`.
  PackedMatrix without(int skipped, std::vector<float>& store) const {
    const int used = channels - skipped;
    return pack_matrix(
        used * 9, columns,
        [&](int k, int n) { return static_cast<float>(at(n, skipped + k % used, k / used)); }, bias,
        store);
  }
  // The first `count` channels, tap by tap.
  PackedMatrix taps_of(int count, std::vector<float>& store) const {
    return pack_matrix(
        count, 9 * columns,
        [&](int k, int n) { return static_cast<float>(at(n % columns, k, n / columns)); }, {},
        store);
  }
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
        ASSERT_NEAR(out[i], sum, 4e-6 * 9 * (in.channels + 4)) << y << ", " << x << ", " << n;
      }
    }
  }
  ASSERT_EQ(i, out.size());
}

ConvInput as_input(const Image& image, const std::vector<float>& values, Upsampling upsampling) {
  return {values.data(), image.height, image.width, image.channels, upsampling};
}

// The same by Winograd's algorithm.
void check_winograd(const Conv3x3& conv, const Image& whole, const Filter& filter, int skipped) {
  const int used = whole.channels - skipped;
  std::vector<float> panels(winograd_floats(used, filter.columns));
  pack_winograd(
      used, filter.columns,
      [&](int c, int n, int tap) { return static_cast<float>(filter.at(n, skipped + c, tap)); },
      panels);
  WinogradConv winograd{{}, conv, panels.data()};
  std::vector<float> out(static_cast<std::size_t>(whole.height * whole.width * filter.columns));
  winograd.conv.output = out.data();
  std::vector<float> scratch(winograd_scratch(winograd));
  const int cut = whole.height / 2 / kWinogradTile * kWinogradTile;
  winograd_rows(winograd, cut, whole.height, scratch.data());
  if (cut > 0) winograd_rows(winograd, 0, cut, scratch.data());
  expect_convolved(whole, filter, conv, out);
}

// One or two random inputs through a random filter, in three slices as three workers would.
void check_conv(Random& random, const Image& first, Upsampling upsampling, int second_channels,
                int stride, Padding padding, int columns) {
  const auto first_values = to_floats(first.values);
  Image whole = upsampled(first, upsampling);
  Conv3x3 conv;
  const bool bilinear = upsampling == Upsampling::kBilinear;
  conv.input_count = 0;
  if (!bilinear) conv.inputs[0] = as_input(first, first_values, upsampling);
  if (!bilinear) ++conv.input_count;
  Image second;
  std::vector<float> second_values;
  if (second_channels > 0) {
    second = make_image(random, whole.height, whole.width, second_channels);
    second_values = to_floats(second.values);
    conv.inputs[static_cast<std::size_t>(conv.input_count++)] =
        as_input(second, second_values, Upsampling::kNone);
    whole = joined(whole, second);
  }
  const Filter filter(random, columns, whole.channels);
  const int skipped = bilinear ? first.channels : 0;
  std::vector<float> taps_store(packed_floats(first.channels, 9 * columns));
  if (bilinear) {
    conv.upsampled = {first_values.data(), first.height, first.width, first.channels,
                      filter.taps_of(first.channels, taps_store)};
  }
  std::vector<float> direct_store(packed_floats((whole.channels - skipped) * 9, columns));
  std::vector<float> out(
      static_cast<std::size_t>(whole.height / stride * (whole.width / stride) * columns));
  conv.height = whole.height;
  conv.width = whole.width;
  conv.channels = whole.channels - skipped;
  conv.stride = stride;
  conv.padding = padding;
  conv.weights = filter.without(skipped, direct_store);
  conv.output = out.data();
  const ConvChain chain = {{conv}, 1};
  std::vector<float> scratch(conv3x3_scratch(chain));
  const int rows = whole.height / stride;
  conv3x3_rows(chain, rows / 2, rows, scratch.data());
  conv3x3_rows(chain, 0, rows / 3, scratch.data());
  conv3x3_rows(chain, rows / 3, rows / 2, scratch.data());
  expect_convolved(whole, filter, conv, out);
  if (stride == 1 && conv.input_count > 0) check_winograd(conv, whole, filter, skipped);
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
          if (how == Upsampling::kBilinear && padding == Padding::kReflect) continue;  // no preset
          for (const int columns : {1, 8, 23}) {
            check_conv(random, image, how, second, 1, padding, columns);
          }
        }
      }
    }
  });
}

// Upsampled, then three convolutions, in slices: the same as one after the other in memory.
TEST(Conv3x3Kernel, ChainsWithoutStoringWhatIsBetween) {
  for_each_isa([] {
    Random random(3);
    const Image image = make_image(random, 4, 7, 8);
    const auto values = to_floats(image.values);
    const Filter filters[3] = {{random, 8, 8}, {random, 16, 8}, {random, 20, 16}};
    std::vector<float> taps_store(packed_floats(8, 9 * 8));
    ConvChain chain;
    chain.count = 3;
    std::vector<float> outputs[3];
    for (std::size_t i = 0; i < 3; ++i) {
      Conv3x3& conv = chain.convs[i];
      conv.height = 8;
      conv.width = 14;
      conv.channels = filters[i].channels;
      conv.weights = filters[i].packed;
      outputs[i].resize(8U * 14U * static_cast<std::size_t>(filters[i].columns));
      conv.output = outputs[i].data();
    }
    Conv3x3& first = chain.convs[0];
    first.upsampled = {values.data(), 4, 7, 8, filters[0].taps_of(8, taps_store)};
    first.input_count = 0;
    first.channels = 0;
    std::vector<float> scratch(conv3x3_scratch(chain));
    for (const bool kept : {true, false}) {
      if (!kept) chain.convs[0].output = chain.convs[1].output = nullptr;
      std::fill(outputs[2].begin(), outputs[2].end(), 0.0F);
      conv3x3_rows(chain, 3, 8, scratch.data());
      conv3x3_rows(chain, 0, 3, scratch.data());
      Image in = upsampled(image, Upsampling::kBilinear);
      for (std::size_t i = 0; i < 3; ++i) {
        expect_convolved(in, filters[i], chain.convs[i], outputs[i]);
        in = {8, 14, filters[i].columns, {outputs[i].begin(), outputs[i].end()}};
      }
    }
    // The last one by Winograd's algorithm, fed by the first two.
    std::vector<float> panels(winograd_floats(16, 20));
    const auto weight = [&](int c, int n, int tap) {
      return static_cast<float>(filters[2].at(n, c, tap));
    };
    pack_winograd(16, 20, weight, panels);
    WinogradConv winograd{chain, chain.convs[2], panels.data()};
    winograd.before.count = 2;
    const std::vector<float> direct = outputs[2];
    std::fill(outputs[2].begin(), outputs[2].end(), 0.0F);
    std::vector<float> more(winograd_scratch(winograd));
    winograd_rows(winograd, 4, 8, more.data());
    winograd_rows(winograd, 0, 4, more.data());
    for (std::size_t i = 0; i < direct.size(); ++i) ASSERT_NEAR(outputs[2][i], direct[i], 2e-3);
  });
}

double silu(double x) { return x / (1 + std::exp(-x)); }

// A 1x1 convolution: [columns][channels] weights, packed.
struct Pointwise {
  int columns;
  int channels;
  std::vector<float> weights;
  std::vector<float> bias;
  std::vector<float> packed_store;
  PackedMatrix packed;

  Pointwise(Random& random, int out_channels, int in_channels)
      : columns(out_channels),
        channels(in_channels),
        weights(random.reals(static_cast<std::size_t>(out_channels * in_channels))),
        bias(random.reals(static_cast<std::size_t>(out_channels))),
        packed_store(packed_floats(in_channels, out_channels)),
        packed(pack_matrix(
            in_channels, out_channels,
            [this](int k, int n) { return weights[static_cast<std::size_t>(n * channels + k)]; },
            bias, packed_store)) {}

  Image of(const Image& in) const {
    Image out{in.height, in.width, columns, {}};
    for (int p = 0; p < in.height * in.width; ++p) {
      for (int n = 0; n < columns; ++n) {
        double sum = static_cast<double>(bias[static_cast<std::size_t>(n)]);
        for (int c = 0; c < channels; ++c) {
          sum += static_cast<double>(weights[static_cast<std::size_t>(n * channels + c)]) *
                 in.values[static_cast<std::size_t>(p * channels + c)];
        }
        out.values.push_back(sum);
      }
    }
    return out;
  }
};

Image depthwise(const Image& in, int stride, const std::vector<float>& taps,
                const std::vector<float>& bias) {
  Image out{in.height / stride, in.width / stride, in.channels, {}};
  for (int y = 0; y < out.height; ++y) {
    for (int x = 0; x < out.width; ++x) {
      for (int c = 0; c < in.channels; ++c) {
        double sum = static_cast<double>(bias[static_cast<std::size_t>(c)]);
        for (int t = 0; t < 9; ++t) {
          sum += static_cast<double>(taps[static_cast<std::size_t>(t * in.channels + c)]) *
                 in.padded(y * stride + t / 3 - 1, x * stride + t % 3 - 1, c, Padding::kZero);
        }
        out.values.push_back(sum);
      }
    }
  }
  return out;
}

void expect_near(const std::vector<float>& got, const Image& want, double tolerance) {
  ASSERT_EQ(got.size(), want.values.size());
  for (std::size_t i = 0; i < got.size(); ++i) ASSERT_NEAR(got[i], want.values[i], tolerance) << i;
}

// The block in one pass against its three layers one after the other, with borders, over several
// strips, and in slices as several workers would.
void check_inverted_residual(Random& random, int channels, int hidden, int columns, int stride,
                             int height, int width) {
  SCOPED_TRACE(testing::Message() << channels << " -> " << hidden << " -> " << columns
                                  << ", stride " << stride << ", " << width << "x" << height);
  const Image in = make_image(random, height, width, channels);
  const Pointwise expand(random, hidden, channels);
  const auto taps = random.reals(static_cast<std::size_t>(9 * hidden));
  const auto taps_bias = random.reals(static_cast<std::size_t>(hidden));
  const Pointwise project(random, columns, hidden);
  Image expanded = expand.of(in);
  for (double& v : expanded.values) v = silu(v);
  Image filtered = depthwise(expanded, stride, taps, taps_bias);
  for (double& v : filtered.values) v = silu(v);
  Image want = project.of(filtered);
  const bool residual = stride == 1 && channels == columns;
  for (std::size_t i = 0; residual && i < want.values.size(); ++i) want.values[i] += in.values[i];

  const auto values = to_floats(in.values);
  std::vector<float> out(want.values.size());
  std::vector<float> seen_expanded(expanded.values.size());
  std::vector<float> seen_filtered(filtered.values.size());
  InvertedResidual block;
  block.input = values.data();
  block.height = height;
  block.width = width;
  block.channels = channels;
  block.hidden = hidden;
  block.stride = stride;
  block.expand = expand.packed;
  block.taps = taps.data();
  block.taps_bias = taps_bias.data();
  block.project = project.packed;
  block.residual = residual ? values.data() : nullptr;
  block.output = out.data();
  block.expanded = seen_expanded.data();
  block.filtered = seen_filtered.data();
  std::vector<float> scratch(inverted_residual_scratch(block));
  const int rows = height / stride;
  inverted_residual_rows(block, rows / 2, rows, scratch.data());
  inverted_residual_rows(block, 0, rows / 2, scratch.data());
  expect_near(seen_expanded, expanded, 1e-4);
  expect_near(seen_filtered, filtered, 1e-4);
  expect_near(out, want, 1e-5 * hidden);
}

TEST(InvertedResidualKernel, IsItsThreeLayersInOnePass) {
  for_each_isa([] {
    Random random(4);
    for (const int stride : {1, 2}) {
      for (const int hidden : {1, 8, 20, 48}) {
        check_inverted_residual(random, 5, hidden, 5, stride, stride * random.whole(1, 6),
                                stride * random.whole(1, 12));
      }
      check_inverted_residual(random, 16, 640, 24, stride, 6, 84);  // several strips
    }
  });
}

// A head step on random weights, and the same figures made plainly: embed, add, convolve, scale.
struct HeadCase {
  Image condition, state, hidden, out;
  std::vector<float> shared, state_values, scale, bias, time, embed, conv1, composed, constant;
  std::vector<float> taps;
  HeadStep step;
};

double tap_sum(const Image& image, const std::vector<float>& taps, int y, int x, int c, int n) {
  // taps [9, image.channels, filters]: filter n, channel c
  double sum = 0;
  const auto filters = static_cast<int>(taps.size()) / 9 / image.channels;
  for (int t = 0; t < 9; ++t) {
    sum += static_cast<double>(
               taps[static_cast<std::size_t>((t * image.channels + c) * filters + n)]) *
           image.padded(y + t / 3 - 1, x + t % 3 - 1, c, Padding::kZero);
  }
  return sum;
}

Image convolved(const Image& in, const std::vector<float>& taps, int filters) {
  Image out{in.height, in.width, filters, {}};
  for (int y = 0; y < in.height; ++y) {
    for (int x = 0; x < in.width; ++x) {
      for (int n = 0; n < filters; ++n) {
        double sum = 0;
        for (int c = 0; c < in.channels; ++c) sum += tap_sum(in, taps, y, x, c, n);
        out.values.push_back(sum);
      }
    }
  }
  return out;
}

// conv1 of embed's taps and of the time, as one 5x5 and one constant.
void compose(HeadCase& h, int channels) {
  const auto n = static_cast<std::size_t>(channels);
  h.composed.assign(25 * n, 0);
  h.constant = h.bias;
  for (std::size_t t = 0; t < 9; ++t) {
    for (std::size_t c = 0; c < n; ++c) {
      for (std::size_t o = 0; o < n; ++o) {
        const float w = h.scale[o] * h.conv1[(t * n + c) * n + o];
        h.constant[o] += w * h.time[c];
        for (std::size_t e = 0; e < 9; ++e) {
          h.composed[(5 * (t / 3 + e / 3) + t % 3 + e % 3) * n + o] += w * h.embed[e * n + c];
        }
      }
    }
  }
}

void fill_head_case(HeadCase& h, Random& random, int height, int width, int channels, bool zero) {
  const auto n = static_cast<std::size_t>(channels);
  h.condition = make_image(random, height, width, channels);
  h.state = make_image(random, height, width, 1);
  if (zero) std::fill(h.state.values.begin(), h.state.values.end(), 0.0);
  h.scale = random.reals(n, 0.5F, 1.5F);
  h.bias = random.reals(n);
  h.time = random.reals(n);
  h.embed = random.reals(9 * n);
  h.conv1 = random.reals(9 * n * n);
  h.taps = random.reals(9 * n);
  compose(h, channels);
  Image fused = convolved(h.state, h.embed, channels);
  for (std::size_t i = 0; i < fused.values.size(); ++i) {
    fused.values[i] += h.condition.values[i] + static_cast<double>(h.time[i % n]);
  }
  h.hidden = convolved(fused, h.conv1, channels);
  for (std::size_t i = 0; i < h.hidden.values.size(); ++i) {
    const auto scaled = static_cast<double>(h.scale[i % n]) * h.hidden.values[i];
    h.hidden.values[i] = std::max(0.0, scaled + static_cast<double>(h.bias[i % n]));
  }
  h.out = convolved(h.hidden, h.taps, 1);
  h.shared = to_floats(convolved(h.condition, h.conv1, channels).values);
  h.state_values = to_floats(h.state.values);
  h.step = {h.shared.data(),
            zero ? nullptr : h.state_values.data(),
            height,
            width,
            channels,
            h.scale.data(),
            h.composed.data(),
            h.constant.data(),
            h.bias.data(),
            h.embed.data(),
            h.time.data(),
            h.conv1.data(),
            true,
            nullptr};
}

// The whole image inside the border, hardly more than the border, and next to nothing.
TEST(HeadKernel, SharesTheConditionsConvolutionExactlyBordersIncluded) {
  for_each_isa([] {
    Random random(5);
    for (const bool zero : {false, true}) {
      for (const int channels : {4, 16, 20}) {
        for (const auto& [height, width] : {std::pair{7, 37}, {5, 6}, {2, 3}}) {
          HeadCase h;
          fill_head_case(h, random, height, width, channels, zero);
          std::vector<float> hidden(h.hidden.values.size());
          h.step.hidden = hidden.data();
          head_hidden_rows(h.step, height / 2, height);
          head_hidden_rows(h.step, 0, height / 2);
          expect_near(hidden, h.hidden, 2e-4);
        }
      }
    }
  });
}

TEST(HeadKernel, UpdatesTheStateInTheSamePass) {
  for_each_isa([] {
    Random random(6);
    for (const int channels : {4, 16, 20}) {
      constexpr int kHeight = 6;
      constexpr int kWidth = 37;
      HeadCase h;
      fill_head_case(h, random, kHeight, kWidth, channels, false);
      std::vector<float> weights(update_weight_floats(channels));
      pack_update_weights(h.taps.data(), channels, weights.data());
      std::vector<float> next(kHeight * kWidth);
      std::vector<float> seen(h.hidden.values.size());
      h.step.hidden = seen.data();
      HeadUpdate update{nullptr, h.step, weights.data(),        0.25F,
                        1.5F,    -0.5F,  h.state_values.data(), next.data()};
      std::vector<float> scratch(head_update_scratch(update));
      Image want = h.out;
      for (std::size_t i = 0; i < next.size(); ++i) {
        want.values[i] = 1.5 * h.state.values[i] - 0.5 * (0.25 + want.values[i]);
      }
      head_update_rows(update, 3, kHeight, scratch.data());
      head_update_rows(update, 0, 3, scratch.data());
      expect_near(next, want, 1e-3);
      expect_near(seen, h.hidden, 2e-4);

      update.hidden = seen.data();  // a norm made it: it is read instead
      std::fill(next.begin(), next.end(), 0.0F);
      head_update_rows(update, 0, kHeight, scratch.data());
      expect_near(next, want, 1e-3);
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
