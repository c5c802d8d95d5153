#include "model/depth_code.h"

namespace lcdm::model {
namespace {

constexpr double kFar = 1 / kMaxDepth;
constexpr double kSpan = 1 / kMinDepth - kFar;
constexpr double kMargin = 1e-4;

}  // namespace

torch::Tensor variable_of_depth(const torch::Tensor& depth, const ModelConfig& config) {
  const torch::Tensor disparity =
      ((depth.clamp_min(1e-6).reciprocal() - kFar) / kSpan).clamp(kMargin, 1 - kMargin);
  return (torch::logit(disparity) - config.variable_mean) / config.variable_std;
}

torch::Tensor disparity_of_variable(const torch::Tensor& variable, const ModelConfig& config) {
  return torch::sigmoid(variable * config.variable_std + config.variable_mean);
}

torch::Tensor depth_of_variable(const torch::Tensor& variable, const ModelConfig& config) {
  return (disparity_of_variable(variable, config) * kSpan + kFar).reciprocal();
}

torch::Tensor log_depth_of_variable(const torch::Tensor& variable, const ModelConfig& config) {
  return -(disparity_of_variable(variable, config) * kSpan + kFar).log();
}

}  // namespace lcdm::model
