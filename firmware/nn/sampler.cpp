#include "firmware/nn/sampler.h"

#include <cmath>

namespace lcdm {
namespace {

constexpr int kT = ModelConfig::kDiffusionSteps;
constexpr double kFirstBeta = 1e-4;
constexpr double kLastBeta = 0.02;

// From abar = a to abar = b, predicting v: x0 = sqrt(a) x - sqrt(1-a) out,
// e = sqrt(1-a) x + sqrt(a) out, x <- sqrt(b) x0 + sqrt(1-b) e.
SamplerStep v_update(int time, double a, double b) {
  return {time, std::sqrt(b * a) + std::sqrt((1 - b) * (1 - a)),
          std::sqrt((1 - b) * a) - std::sqrt(b * (1 - a))};
}

// The same predicting eps: x0 = (x - sqrt(1-a) out) / sqrt(a), e = out.
SamplerStep eps_update(int time, double a, double b) {
  return {time, std::sqrt(b / a), std::sqrt(1 - b) - std::sqrt(b * (1 - a) / a)};
}

}  // namespace

std::vector<double> cumulative_alphas(PresetKind preset) {
  std::vector<double> abar(kT);
  double product = 1;
  for (int t = 0; t < kT; ++t) {
    product *= 1 - (kFirstBeta + (kLastBeta - kFirstBeta) * t / (kT - 1));
    abar[static_cast<std::size_t>(t)] = product;
  }
  if (preset == PresetKind::kPaper) return abar;

  const double first = std::sqrt(abar.front());
  const double last = std::sqrt(abar.back());
  for (double& a : abar) {
    const double s = (std::sqrt(a) - last) * first / (first - last);
    a = s * s;
  }
  return abar;
}

std::vector<int> sampler_times(PresetKind preset, int n) {
  LCDM_CHECK(n >= 1 && n <= kT);
  std::vector<int> times;
  for (int k = 0; k < n; ++k) {
    const double trailing = std::round(kT - static_cast<double>(k) * kT / n) - 1;
    times.push_back(preset == PresetKind::kLcdm ? static_cast<int>(trailing)
                                                : (n - 1 - k) * (kT / n));
  }
  return times;
}

std::vector<SamplerStep> make_sampler(const ModelConfig& config) {
  const std::vector<double> abar = cumulative_alphas(config.preset);
  std::vector<SamplerStep> steps;
  for (std::size_t k = 0; k < config.steps.size(); ++k) {
    const int time = config.steps[k];
    const double a = abar[static_cast<std::size_t>(time)];
    const bool last = k + 1 == config.steps.size();
    const double b = last ? 1 : abar[static_cast<std::size_t>(config.steps[k + 1])];
    steps.push_back(config.preset == PresetKind::kLcdm ? v_update(time, a, b)
                                                       : eps_update(time, a, b));
  }
  return steps;
}

}  // namespace lcdm
