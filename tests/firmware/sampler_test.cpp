// The noise schedule, the sampler's constants, and what they mean.
#include "firmware/nn/sampler.h"

#include <cmath>
#include <gtest/gtest.h>
#include <numeric>

#include "firmware/nn/noise.h"
#include "tests/support/random_model.h"

namespace lcdm {
namespace {

constexpr auto kLcdm = PresetKind::kLcdm;
constexpr auto kPaper = PresetKind::kPaper;

std::vector<SamplerStep> sampler_of(PresetKind preset) {
  return make_sampler(test::make_config(EncoderKind::kXs, preset));
}

TEST(Schedule, LcdmEndsInPureNoise) {
  const auto abar = cumulative_alphas(kLcdm);
  ASSERT_EQ(abar.size(), 150U);
  EXPECT_EQ(abar[149], 0.0);
  EXPECT_NEAR(abar[74], 0.456, 5e-4);
  EXPECT_NEAR(abar[0], 1 - 1e-4, 1e-12);  // the rescaling keeps the first
}

TEST(Schedule, PaperNeverGetsThere) {
  const auto abar = cumulative_alphas(kPaper);
  EXPECT_NEAR(abar[75], 0.677, 5e-4);
  EXPECT_NEAR(abar[149], 0.219, 5e-4);
  EXPECT_NEAR(abar[0], 1 - 1e-4, 1e-12);
}

TEST(Schedule, TimesAreTrailingOrLeading) {
  EXPECT_EQ(sampler_times(kLcdm, 1), (std::vector<int>{149}));
  EXPECT_EQ(sampler_times(kLcdm, 2), (std::vector<int>{149, 74}));
  EXPECT_EQ(sampler_times(kLcdm, 4), (std::vector<int>{149, 112, 74, 37}));
  EXPECT_EQ(sampler_times(kPaper, 2), (std::vector<int>{75, 0}));
  EXPECT_EQ(sampler_times(kPaper, 3), (std::vector<int>{100, 50, 0}));
}

// With the true v or eps of a known x0, every update lands on the same trajectory and the last one
// on x0 itself.
TEST(Sampler, TruePredictionsLeadToTheTruth) {
  for (const auto preset : {kLcdm, kPaper}) {
    const auto abar = cumulative_alphas(preset);
    for (const int n : {1, 2, 3, 10}) {
      ModelConfig config = test::make_config(EncoderKind::kXs, preset);
      config.steps = sampler_times(preset, n);
      const double x0 = 0.7;
      const double e = -1.3;
      const auto steps = make_sampler(config);
      const auto noisy = [&](int t) {
        const double a = abar[static_cast<std::size_t>(t)];
        return std::sqrt(a) * x0 + std::sqrt(1 - a) * e;
      };
      double x = noisy(steps.front().time);
      for (std::size_t k = 0; k < steps.size(); ++k) {
        const double a = abar[static_cast<std::size_t>(steps[k].time)];
        const double v = std::sqrt(a) * e - std::sqrt(1 - a) * x0;
        x = steps[k].p * x + steps[k].q * (preset == kLcdm ? v : e);
        const double expected = k + 1 < steps.size() ? noisy(steps[k + 1].time) : x0;
        EXPECT_NEAR(x, expected, 1e-12) << to_string(preset) << " step " << k << " of " << n;
      }
    }
  }
}

// From pure noise, v is -x0: the first update gives sqrt(abar_74) x0 + sqrt(1 - abar_74) x_149.
TEST(Sampler, FirstLcdmStepMixesThePredictionWithTheStart) {
  const auto steps = sampler_of(kLcdm);
  ASSERT_EQ(steps.size(), 2U);
  const double abar = cumulative_alphas(kLcdm)[74];
  EXPECT_NEAR(steps[0].p, std::sqrt(1 - abar), 1e-12);
  EXPECT_NEAR(steps[0].q, -std::sqrt(abar), 1e-12);
  EXPECT_NEAR(-steps[0].q, 0.675, 5e-4);  // all that a start of zeros leaves: .675 x0
}

// The trap of the paper's schedule: its second step, at t = 0, moves the value by only 0.01 for
// each unit by which the two predictions differ.
TEST(Sampler, SecondPaperStepHardlyMoves) {
  const auto steps = sampler_of(kPaper);
  ASSERT_EQ(steps[1].time, 0);
  const double abar75 = cumulative_alphas(kPaper)[75];
  const double start = 0.4;
  const double first = 1.1;
  const double second = -0.3;
  // x0 as the first step alone predicts it, against the result of both.
  const double one = (start - std::sqrt(1 - abar75) * first) / std::sqrt(abar75);
  const double two = steps[1].p * (steps[0].p * start + steps[0].q * first) + steps[1].q * second;
  EXPECT_NEAR(two - one, 0.01 * (first - second), 1e-5);
}

TEST(Noise, IsAFunctionOfSeedAndIndex) {
  std::vector<float> a(1001);
  std::vector<float> b(500);
  fill_gaussian(7, a);
  fill_gaussian(7, b);
  EXPECT_TRUE(std::equal(b.begin(), b.end(), a.begin()));
  fill_gaussian(8, b);
  EXPECT_FALSE(std::equal(b.begin(), b.end(), a.begin()));
}

// Golden, computed apart from this code: weights are trained with these very values.
TEST(Noise, FirstValuesStayWhatTheyAre) {
  std::vector<float> noise(4);
  fill_gaussian(1, noise);
  EXPECT_FLOAT_EQ(noise[0], -0.028249746F);
  EXPECT_FLOAT_EQ(noise[1], -1.0656176F);
  EXPECT_FLOAT_EQ(noise[2], -0.22791952F);
  EXPECT_FLOAT_EQ(noise[3], 0.083094168F);
}

TEST(Noise, IsGaussian) {
  std::vector<float> noise(200000);
  fill_gaussian(3, noise);
  const double n = static_cast<double>(noise.size());
  double mean = 0;
  double variance = 0;
  double fourth = 0;
  double neighbour = 0;
  for (std::size_t i = 0; i < noise.size(); ++i) {
    const auto v = static_cast<double>(noise[i]);
    mean += v / n;
    variance += v * v / n;
    fourth += v * v * v * v / n;
    if (i > 0) neighbour += v * static_cast<double>(noise[i - 1]) / n;
  }
  EXPECT_NEAR(mean, 0, 0.01);
  EXPECT_NEAR(variance, 1, 0.02);
  EXPECT_NEAR(fourth, 3, 0.1);
  EXPECT_NEAR(neighbour, 0, 0.01);
}

}  // namespace
}  // namespace lcdm
