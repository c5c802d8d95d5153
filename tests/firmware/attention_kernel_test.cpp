// Attention by heads, and the norms around it, against the formulas in double.
#include <algorithm>
#include <cmath>
#include <gtest/gtest.h>
#include <limits>

#include "firmware/nn/kernels/attention.h"
#include "firmware/nn/kernels/matrix.h"
#include "firmware/nn/kernels/norm.h"
#include "tests/firmware/image.h"

namespace lcdm::kernels {
namespace {

double expected_attention(const Attention& a, int position, int head, int query, int c) {
  const int head_channels = a.channels / a.heads;
  const auto value = [&](int token, int part, int channel) {
    const int row = position * a.tokens + token;
    const int column = part * a.channels + head * head_channels + channel;
    return static_cast<double>(a.qkv[row * 3 * a.channels + column]);
  };
  double total = 0;
  double mixed = 0;
  for (int key = 0; key < a.tokens; ++key) {
    double dot = 0;
    for (int i = 0; i < head_channels; ++i) dot += value(query, 0, i) * value(key, 1, i);
    const double e = std::exp(dot / std::sqrt(head_channels));
    total += e;
    mixed += e * value(key, 2, c);
  }
  return mixed / total;
}

// Numbers up to `reach`: from about 6 on, scores are compared with the largest before they become
// powers.
void check_attention(int tokens, int head_channels, Precision precision = Precision::kFloat32,
                     float reach = 3) {
  SCOPED_TRACE(testing::Message() << tokens << " tokens, " << head_channels << " channels");
  Random random(static_cast<unsigned>(tokens * 100 + head_channels));
  Attention a;
  a.positions = 2;
  a.heads = 4;
  a.tokens = tokens;
  a.channels = 4 * head_channels;
  a.precision = precision;
  const auto values = static_cast<std::size_t>(a.positions) * static_cast<std::size_t>(tokens) *
                      static_cast<std::size_t>(a.channels);
  const auto qkv = random.reals(values * 3, -reach, reach);
  std::vector<float> out(values);
  a.qkv = qkv.data();
  a.output = out.data();
  std::vector<float> scratch(attention_scratch(a) + 1, kUntouched);
  attention_range(a, 0, attention_items(a), scratch.data());
  EXPECT_EQ(scratch.back(), kUntouched) << "wrote behind its scratch";
  for (std::size_t i = 0; i < values; ++i) {
    const int channel = static_cast<int>(i) % a.channels;
    const int token = static_cast<int>(i) / a.channels;
    ASSERT_NEAR(out[i],
                expected_attention(a, token / tokens, channel / head_channels, token % tokens,
                                   channel % head_channels),
                precision == Precision::kFloat32 ? 4e-7 * std::pow(reach, 3) : reach * reach / 60)
        << i;
  }
}

TEST(AttentionKernel, MixesValuesByTheSoftmaxOfScores) {
  for_each_isa([] {
    for (const int tokens : {1, 2, 5, 16, 31, 33, 40}) {
      for (const int head_channels : {1, 5, 16, 30}) {
        for (const float reach : {3.0F, 12.0F}) {
          check_attention(tokens, head_channels, Precision::kFloat32, reach);
        }
      }
    }
  });
}

TEST(AttentionKernel, MixesHalves) {
  for_each_isa([] {
    for (const Precision precision : {Precision::kFloat16, Precision::kBfloat16}) {
      if (support_of(precision) == Support::kNone) continue;
      for (const int tokens : {1, 2, 5, 16, 31, 33, 40, 131}) {
        for (const int head_channels : {2, 16, 24, 30}) {
          for (const float reach : {3.0F, 6.0F}) {
            check_attention(tokens, head_channels, precision, reach);
          }
        }
      }
    }
  });
}

// One key has score s, the others 0, and it alone has a value: p, so that p / (1 - p) is e^s over
// the number of the others. e^s is as exact as halves of it need, whatever the fraction of s.
TEST(AttentionKernel, PowersBesideHalvesAreWithinOnePercent) {
  for_each_isa([] {
    for (const Precision precision : {Precision::kFloat16, Precision::kBfloat16}) {
      if (support_of(precision) == Support::kNone) continue;
      SCOPED_TRACE(to_string(precision));
      constexpr int kTokens = 81;
      constexpr int kChannels = 2;
      const auto score = [](int token) { return static_cast<float>(token - kTokens / 2) / 40; };
      std::vector<float> qkv(std::size_t{3} * kChannels * kTokens);
      for (int token = 0; token < kTokens; ++token) {
        qkv[static_cast<std::size_t>(token) * 3 * kChannels] = score(token) * std::sqrt(2.0F);
      }
      qkv[kChannels] = 1;      // the first key
      qkv[2 * kChannels] = 1;  // its value
      std::vector<float> out(std::size_t{kTokens} * kChannels);
      const Attention a = {qkv.data(), 1, kTokens, kChannels, 1, out.data(), precision};
      std::vector<float> scratch(attention_scratch(a));
      attention_range(a, 0, attention_items(a), scratch.data());
      for (int token = 0; token < kTokens; ++token) {
        const float p = out[static_cast<std::size_t>(token) * kChannels];
        const float power = p / (1 - p) * (kTokens - 1);
        EXPECT_NEAR(power / std::exp(score(token)), 1, .015) << "score " << score(token);
      }
    }
  });
}

TEST(AttentionKernel, NeedsRoomForKeysAndValuesOnlyWhereTheyAreMadeNarrow) {
  for_each_isa([] {
    Attention a = {nullptr, 1, 33, 4 * 30, 4, nullptr};
    const std::size_t floats = attention_scratch(a);
    a.precision = Precision::kBfloat16;
    EXPECT_EQ(attention_scratch(a) - floats, 33U * 15 + 17U * 30);
    a.precision = Precision::kFloat16;
    EXPECT_EQ(attention_scratch(a) - floats, 33U * 15 + 17U * 30);
  });
}

TEST(AttentionKernel, ScratchGrowsWithTheTokensNotWithTheirPairs) {
  for_each_isa([] {
    for (const Precision precision :
         {Precision::kFloat32, Precision::kFloat16, Precision::kBfloat16}) {
      const auto floats = [precision](int tokens) {
        return attention_scratch({nullptr, 4, tokens, 4 * 24, 4, nullptr, precision});
      };
      EXPECT_LE(floats(4 * 1280), 4 * floats(1280));
    }
  });
}

TEST(AttentionKernel, SurvivesScoresThatWouldOverflow) {
  for_each_isa([] {
    // One token attends to itself alone, however large its score.
    for (const Precision precision :
         {Precision::kFloat32, Precision::kFloat16, Precision::kBfloat16}) {
      if (support_of(precision) == Support::kNone) continue;
      const int channels = 2 * 4;
      std::vector<float> qkv(3 * channels, 3 << 18);
      std::vector<float> out(channels);
      const Attention a = {qkv.data(), 1, 1, channels, 4, out.data(), precision};
      std::vector<float> scratch(attention_scratch(a));
      attention_range(a, 0, attention_items(a), scratch.data());
      for (const float v : out) EXPECT_EQ(v, 3 << 18) << to_string(precision);
    }
  });
}

// Scores beyond what floats hold cannot be compared: no depth then, not the mean of all values.
TEST(AttentionKernel, ScoresThatAreInfiniteOrNoNumberGiveNone) {
  for_each_isa([] {
    constexpr int kTokens = 4;
    constexpr int kChannels = 2 * 4;
    for (const float value :
         {1e20F, std::numeric_limits<float>::infinity(), std::numeric_limits<float>::quiet_NaN()}) {
      for (const int part : {0, 1}) {  // of queries, of keys
        for (const Precision precision :
             {Precision::kFloat32, Precision::kFloat16, Precision::kBfloat16}) {
          if (support_of(precision) == Support::kNone) continue;
          std::vector<float> qkv(std::size_t{3} * kTokens * kChannels, 1);
          std::fill_n(qkv.begin() + part * kChannels, kChannels, value);
          if (value == 1e20F) std::fill_n(qkv.begin(), 2 * kChannels, value);
          std::vector<float> out(std::size_t{kTokens} * kChannels);
          const Attention a = {qkv.data(), 1, kTokens, kChannels, 4, out.data(), precision};
          std::vector<float> scratch(attention_scratch(a));
          attention_range(a, 0, attention_items(a), scratch.data());
          EXPECT_TRUE(std::isnan(out[0]))
              << value << " in " << part << ", " << to_string(precision);
        }
      }
    }
  });
}

// ---- normalisation ----

TEST(NormKernel, LayerNormGivesEachRowMeanZeroAndDeviationOne) {
  for_each_isa([] {
    for (const int channels : {1, 3, 16, 40, 65}) {
      Random random(static_cast<unsigned>(channels));
      const int rows = 5;
      const auto width = static_cast<std::size_t>(channels);
      const auto in = random.reals(rows * width, -5, 20);
      const auto weight = random.reals(width);
      const auto bias = random.reals(width);
      std::vector<float> out(in.size());
      layer_norm_rows({in.data(), channels, weight.data(), bias.data(), 1e-5F, out.data()}, 0,
                      rows);
      for (std::size_t row = 0; row < rows; ++row) {
        double mean = 0;
        double variance = 0;
        for (std::size_t c = 0; c < width; ++c) {
          mean += static_cast<double>(in[row * width + c]) / channels;
        }
        for (std::size_t c = 0; c < width; ++c) {
          variance += std::pow(static_cast<double>(in[row * width + c]) - mean, 2) / channels;
        }
        for (std::size_t c = 0; c < width; ++c) {
          const double x =
              (static_cast<double>(in[row * width + c]) - mean) / std::sqrt(variance + 1e-5);
          ASSERT_NEAR(out[row * width + c],
                      x * static_cast<double>(weight[c]) + static_cast<double>(bias[c]), 1e-5);
        }
      }
    }
  });
}

// Against the group's own mean and variance in double.
void check_group_norm(Random& random, const std::vector<float>& in, int height, int width,
                      std::size_t members, double tolerance) {
  const std::size_t channels = 4 * members;
  const std::size_t pixels = in.size() / channels;
  const auto weight = random.reals(channels);
  const auto bias = random.reals(channels);
  std::vector<float> moments(static_cast<std::size_t>(height) * 2 * channels);
  std::vector<float> out(in.size());
  const GroupNorm norm = {
      in.data(),     height,      width, static_cast<int>(channels), 4,
      weight.data(), bias.data(), 1e-5F, Activation::kRelu,          moments.data(),
      out.data()};
  group_norm_moments(norm, 0, height);
  group_norm_apply(norm, 0, height);
  for (std::size_t group = 0; group < 4; ++group) {
    double mean = 0;
    double squares = 0;
    const double count = static_cast<double>(pixels * members);
    const auto each = [&](auto&& f) {
      for (std::size_t p = 0; p < pixels; ++p) {
        for (std::size_t c = group * members; c < (group + 1) * members; ++c) {
          f(p * channels + c, c);
        }
      }
    };
    each([&](std::size_t i, std::size_t) { mean += static_cast<double>(in[i]) / count; });
    each([&](std::size_t i, std::size_t) {
      squares += std::pow(static_cast<double>(in[i]) - mean, 2) / count;
    });
    std::size_t off = 0;  // also by not being a number
    each([&](std::size_t i, std::size_t c) {
      const double x = (static_cast<double>(in[i]) - mean) / std::sqrt(squares + 1e-5);
      const double want = x * static_cast<double>(weight[c]) + static_cast<double>(bias[c]);
      off += std::fabs(static_cast<double>(out[i]) - std::max(0.0, want)) <= tolerance ? 0U : 1U;
    });
    EXPECT_EQ(off, 0U) << "of " << count << " values";
  }
}

TEST(NormKernel, GroupNormUsesTheStatisticsOfItsGroup) {
  for_each_isa([] {
    for (const std::size_t members : {1U, 4U, 5U, 16U}) {
      Random random(static_cast<unsigned>(members));
      check_group_norm(random, random.reals(5 * 7 * 4 * members, -2, 6), 5, 7, members, 1e-4);
    }
  });
}

// Sums of squares less the square of the mean would be rounding alone, and negative at times.
TEST(NormKernel, GroupNormOfValuesThatHardlyDifferIsNoRootOfRounding) {
  for_each_isa([] {
    Random random(9);
    const std::vector<float> flat(std::size_t{3} * 640 * 16, 4.2747F);
    check_group_norm(random, flat, 3, 640, 4, 1e-3);
    check_group_norm(random, random.reals(flat.size(), 99.99F, 100.01F), 3, 640, 4, 5e-3);
    std::vector<float> one_apart = flat;
    one_apart[0] = -1000;
    check_group_norm(random, one_apart, 3, 640, 4, 1e-3);
  });
}

}  // namespace
}  // namespace lcdm::kernels
