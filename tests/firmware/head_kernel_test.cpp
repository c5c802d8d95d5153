// The diffusion head and the way from logit to metres against the sums as they are written.
#include <algorithm>
#include <bit>
#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <utility>

#include "firmware/nn/kernels/head.h"
#include "firmware/nn/kernels/matrix.h"
#include "firmware/nn/kernels/words.h"
#include "tests/firmware/image.h"

namespace lcdm::kernels {
namespace {

// A head step on random weights, and the same figures made plainly: embed, add, convolve, scale.
struct HeadCase {
  Image condition, state, hidden, out;
  std::vector<float> shared, state_values, scale, bias, time, embed, conv1, composed, constant;
  std::vector<float> taps;
  HeadStep step;
};

// taps [9, in.channels, filters]
Image convolved_by(const Image& in, const std::vector<float>& taps, int filters) {
  return convolved(in, filters, 3, 1, Padding::kZero, [&](int n, int c, int t) {
    return static_cast<double>(taps[static_cast<std::size_t>((t * in.channels + c) * filters + n)]);
  });
}

// conv1 of embed's taps and of the time, as one 5x5 and one constant for each place of a pixel, of
// the taps that see the image from there.
void compose(HeadCase& h, int channels) {
  const auto n = static_cast<std::size_t>(channels);
  h.composed.assign(9 * 25 * n, 0);
  for (std::size_t place = 0; place < 9; ++place) {
    h.constant.insert(h.constant.end(), h.bias.begin(), h.bias.end());
    for (std::size_t t = 0; t < 9; ++t) {
      const bool above = place / 3 == 0 && t / 3 == 0;
      const bool below = place / 3 == 2 && t / 3 == 2;
      const bool left = place % 3 == 0 && t % 3 == 0;
      const bool right = place % 3 == 2 && t % 3 == 2;
      if (above || below || left || right) continue;
      for (std::size_t c = 0; c < n; ++c) {
        for (std::size_t o = 0; o < n; ++o) {
          const float w = h.scale[o] * h.conv1[(t * n + c) * n + o];
          h.constant[place * n + o] += w * h.time[c];
          for (std::size_t e = 0; e < 9; ++e) {
            const std::size_t at = 5 * (t / 3 + e / 3) + t % 3 + e % 3;
            h.composed[(place * 25 + at) * n + o] += w * h.embed[e * n + c];
          }
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
  Image fused = convolved_by(h.state, h.embed, channels);
  for (std::size_t i = 0; i < fused.values.size(); ++i) {
    fused.values[i] += h.condition.values[i] + static_cast<double>(h.time[i % n]);
  }
  h.hidden = convolved_by(fused, h.conv1, channels);
  for (std::size_t i = 0; i < h.hidden.values.size(); ++i) {
    const auto scaled = static_cast<double>(h.scale[i % n]) * h.hidden.values[i];
    h.hidden.values[i] = std::max(0.0, scaled + static_cast<double>(h.bias[i % n]));
  }
  h.out = convolved_by(h.hidden, h.taps, 1);
  h.shared = to_floats(convolved_by(h.condition, h.conv1, channels).values);
  h.state_values = to_floats(h.state.values);
  h.step = {h.shared.data(),
            zero ? nullptr : h.state_values.data(),
            height,
            width,
            channels,
            h.scale.data(),
            h.composed.data(),
            h.constant.data(),
            true,
            nullptr};
}

// The whole image inside the border, hardly more than the border, and next to nothing.
TEST(HeadKernel, SharesTheConditionsConvolutionExactlyBordersIncluded) {
  for_each_isa([] {
    Random random(5);
    for (const bool zero : {false, true}) {
      for (const int channels : {4, 16, 20}) {
        for (const auto& [height, width] : {std::pair{7, 37}, {5, 6}, {2, 3}, {3, 2}}) {
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

// Whole numbers that bfloat16 holds exactly: what is left of its rounding is the hidden layer's.
void make_whole(HeadCase& h) {
  for (float& v : h.shared) v = std::round(v);
  for (float& v : h.composed) v = std::round(8 * v);
  for (float& v : h.taps) v = std::round(8 * v);
  for (float& v : h.state_values) v = std::round(8 * v);
}

// The same from the composed taps.
Image hidden_of(const HeadCase& h) {
  Image out = h.hidden;
  const HeadStep& s = h.step;
  for (int y = 0; y < s.height; ++y) {
    for (int x = 0; x < s.width; ++x) {
      const auto along = [](int i, int size) { return i == 0 ? 0 : i == size - 1 ? 2 : 1; };
      const int place = 3 * along(y, s.height) + along(x, s.width);
      for (int c = 0; c < s.channels; ++c) {
        const std::size_t at = static_cast<std::size_t>((y * s.width + x) * s.channels + c);
        double sum = static_cast<double>(s.constant[place * s.channels + c]) +
                     static_cast<double>(s.scale[c]) * static_cast<double>(s.shared[at]);
        for (int t = 0; t < 25; ++t) {
          const double state = h.state.padded(y + t / 5 - 2, x + t % 5 - 2, 0, Padding::kZero);
          sum +=
              state * static_cast<double>(
                          h.composed[static_cast<std::size_t>((place * 25 + t) * s.channels + c)]);
        }
        out.values[at] = std::max(0.0, sum);
      }
    }
  }
  return out;
}

// Each row's pixels two by two.
std::vector<float> in_pairs(const std::vector<float>& shared, int width, int channels) {
  const auto pitch = static_cast<std::size_t>(channels);
  const std::size_t row_floats = static_cast<std::size_t>(width) * pitch;
  std::vector<float> out;
  for (std::size_t row = 0; row < shared.size(); row += row_floats) {
    for (std::size_t pixel = 0; pixel < row_floats; pixel += 2 * pitch) {
      for (std::size_t c = pixel; c < pixel + pitch; ++c) {
        const float second = c + pitch < row_floats ? shared[row + c + pitch] : 0.0F;
        out.push_back(std::bit_cast<float>(bfloat16_pair(shared[row + c], second)));
      }
    }
  }
  return out;
}

struct UpdateCase {
  int channels;
  int height;
  int width;
  bool zero;  // the state is
  Precision precision = Precision::kFloat32;
};

void expect_update(Random& random, const UpdateCase& c) {
  SCOPED_TRACE(testing::Message() << c.channels << " channels, " << c.width << "x" << c.height
                                  << ", " << to_string(c.precision));
  const bool narrow = c.precision != Precision::kFloat32;
  HeadCase h;
  fill_head_case(h, random, c.height, c.width, c.channels, c.zero);
  if (narrow) {
    make_whole(h);
    h.state.values.assign(h.state_values.begin(), h.state_values.end());
    h.hidden = hidden_of(h);
    h.out = convolved_by(h.hidden, h.taps, 1);
  }
  const double rounding = narrow ? rounding_of_sum(h.hidden, 9 * c.channels, c.precision) * 8 : 0;
  const auto composed = pack_composed(h.composed, c.channels, c.precision);
  const auto weights = pack_update_weights(h.taps, c.channels, c.precision);
  h.step.composed = composed.data();
  std::vector<float> next(h.state_values.size());
  std::vector<float> seen(h.hidden.values.size(), kUntouched);
  h.step.hidden = seen.data();
  const auto pairs = in_pairs(h.shared, c.width, c.channels);
  if (narrow) h.step.shared = pairs.data();
  HeadUpdate update{nullptr, h.step, c.precision,           weights.data(), 0.25F,
                    1.5F,    -0.5F,  h.state_values.data(), next.data()};
  std::vector<float> scratch(head_update_scratch(update));
  Image want = h.out;
  for (std::size_t i = 0; i < next.size(); ++i) {
    want.values[i] = 1.5 * h.state.values[i] - 0.5 * (0.25 + want.values[i]);
  }
  const int half = c.height / 2;
  const auto pitch = static_cast<std::size_t>(c.width * c.channels);
  head_update_rows(update, half, c.height, scratch.data());
  expect_only_rows(seen, pitch, static_cast<std::size_t>(half), static_cast<std::size_t>(c.height));
  head_update_rows(update, 0, half, scratch.data());
  expect_near(next, want, 1e-3 + rounding);
  expect_near(seen, h.hidden, 2e-4 * (narrow ? 8 : 1));

  // The same bytes whatever the slices.
  std::vector<float> whole(next.size());
  update.next = whole.data();
  head_update_rows(update, 0, c.height, scratch.data());
  EXPECT_EQ(whole, next);

  if (narrow) return;
  update.hidden = seen.data();  // a norm made it: it is read instead
  std::fill(whole.begin(), whole.end(), 0.0F);
  head_update_rows(update, 0, c.height, scratch.data());
  expect_near(whole, want, 1e-3);
}

// A state of zeros everywhere is none to the hidden layer, but is one to the update.
TEST(HeadKernel, UpdatesTheStateInTheSamePass) {
  for_each_isa([] {
    Random random(6);
    for (const bool zero : {false, true}) {
      for (const int channels : {4, 16, 20}) expect_update(random, {channels, 6, 37, zero});
    }
  });
}

// As many channels as a vector has lanes, where that is a vector at all.
TEST(HeadKernel, UpdatesTheStateInHalves) {
  for_each_isa([] {
    const int channels = vector_lanes();
    if (channels < 4 || support_of(Precision::kBfloat16) == Support::kNone) return;
    Random random(7);
    for (const bool zero : {false, true}) {
      for (const auto& [height, width] :
           {std::pair{6, 37}, {9, 32}, {5, 6}, {2, 3}, {3, 2}, {4, 18}, {2, 48}}) {
        expect_update(random, {channels, height, width, zero, Precision::kBfloat16});
      }
    }
  });
}

TEST(HeadKernel, NarrowIsWhatTheProcessorHasForWholeVectors) {
  for_each_isa([] {
    const bool native = support_of(Precision::kBfloat16) == Support::kNative;
    const Precision halves = native ? Precision::kBfloat16 : Precision::kFloat32;
    EXPECT_EQ(head_precision(Precision::kInt8, vector_lanes()), halves);
    EXPECT_EQ(head_precision(Precision::kBfloat16, vector_lanes()), halves);
    EXPECT_EQ(head_precision(Precision::kBfloat16, vector_lanes() + 4), Precision::kFloat32);
    EXPECT_EQ(head_precision(Precision::kFloat16, vector_lanes()), Precision::kFloat32);
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

// A sum that overflowed: its pixel has no depth, its neighbours keep theirs.
TEST(DepthKernel, MakesNoMetresOfNoNumber) {
  for_each_isa([] {
    constexpr float kInfinite = std::numeric_limits<float>::infinity();
    const float state[] = {0, std::numeric_limits<float>::quiet_NaN(), kInfinite, -kInfinite, 0};
    float metres[5];
    depth_range({state, 1, 0, 1, metres}, 0, 5);
    for (int i = 0; i < 5; ++i) EXPECT_EQ(std::isnan(metres[i]), i >= 1 && i <= 3) << i;
  });
}

}  // namespace
}  // namespace lcdm::kernels
