// One step's losses: what LCDM-Mono minimises, from a batch to a scalar.
#pragma once

#include <torch/types.h>

#include "model/batches.h"
#include "model/depth_net.h"

namespace lcdm::model {

struct LossWeights {
  double denoising = 1;
  double distillation = 1;
  double gradient = 0.5;
  double direct = 0.5;  // the 0-step answer's share of distillation and gradient loss
};

struct StepLosses {
  torch::Tensor total;  // scalar, with gradients
  double denoising = 0;
  double distillation = 0;
  double gradient = 0;
  double direct = 0;
};

// Denoising at random t (Eq. 8) and distillation on the two-step rollout with gradients (Eq. 9).
// `generator` draws every t and every noise.
StepLosses training_losses(DepthNet& net, const Batch& batch, const LossWeights& weights,
                           torch::Generator generator);

}  // namespace lcdm::model
