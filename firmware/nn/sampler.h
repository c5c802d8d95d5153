// The DDIM sampler, folded to two constants per step (NETWORK.md, "Head and sampler").
#pragma once

#include <vector>

#include "firmware/nn/network_config.h"

namespace lcdm {

// One update x <- p x + q out, where `out` is the head's output at time `time`.
struct SamplerStep {
  int time = 0;
  double p = 0;
  double q = 0;
};

// abar_t for t = 0..149: betas linear from 1e-4 to 0.02; `lcdm` rescaled to zero terminal SNR
// (arXiv 2305.08891, Algorithm 1).
std::vector<double> cumulative_alphas(PresetKind preset);

// The times of an n-step sampler: `lcdm` trailing, `paper` leading. 1 <= n <= 150.
std::vector<int> sampler_times(PresetKind preset, int n);

// The updates for config.steps with sigma = 0, the last one leading to abar = 1. `lcdm` predicts v,
// `paper` predicts eps (arXiv 2010.02502, equation 12; arXiv 2202.00512, appendix D).
std::vector<SamplerStep> make_sampler(const ModelConfig& config);

}  // namespace lcdm
