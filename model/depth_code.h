// Between metres and the diffusion variable (NETWORK.md, "Depth"). All tensors [B, 1, H, W].
#pragma once

#include "firmware/nn/network_config.h"
#include "model/torch.h"

namespace lcdm::model {

// Depth at the canonical focal length is kept in this range by 1 / D = 0.01 + 9.99 disparity.
constexpr double kMinDepth = 0.1;
constexpr double kMaxDepth = 100;

// Canonical depth D > 0 -> standardised logit of disparity, disparity held 1e-4 inside (0, 1).
torch::Tensor variable_of_depth(const torch::Tensor& depth, const ModelConfig& config);
// The variable -> disparity in (0, 1).
torch::Tensor disparity_of_variable(const torch::Tensor& variable, const ModelConfig& config);
// The variable -> canonical depth in [0.1, 100].
torch::Tensor depth_of_variable(const torch::Tensor& variable, const ModelConfig& config);
// The variable -> log of canonical depth.
torch::Tensor log_depth_of_variable(const torch::Tensor& variable, const ModelConfig& config);

}  // namespace lcdm::model
