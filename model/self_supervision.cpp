#include "model/self_supervision.h"

namespace lcdm::model {
namespace {

namespace F = torch::nn::functional;

constexpr double kStructureShare = 0.85;
constexpr double kTieBreak = 1e-5;

torch::Tensor window_mean(const torch::Tensor& x) { return torch::avg_pool2d(x, 3, 1); }

torch::Tensor reflected(const torch::Tensor& x) {
  return F::pad(x, F::PadFuncOptions({1, 1, 1, 1}).mode(torch::kReflect));
}

// x[next] - x[this] along an axis.
torch::Tensor difference(const torch::Tensor& x, std::int64_t axis) {
  const std::int64_t n = x.size(axis) - 1;
  return x.narrow(axis, 1, n) - x.narrow(axis, 0, n);
}

}  // namespace

torch::Tensor structural_difference(const torch::Tensor& x, const torch::Tensor& y) {
  constexpr double kC1 = 0.01 * 0.01;
  constexpr double kC2 = 0.03 * 0.03;
  const torch::Tensor a = reflected(x), b = reflected(y);
  const torch::Tensor mean_a = window_mean(a), mean_b = window_mean(b);
  const torch::Tensor variance_a = window_mean(a * a) - mean_a * mean_a;
  const torch::Tensor variance_b = window_mean(b * b) - mean_b * mean_b;
  const torch::Tensor covariance = window_mean(a * b) - mean_a * mean_b;
  const torch::Tensor similarity =
      (2 * mean_a * mean_b + kC1) * (2 * covariance + kC2) /
      ((mean_a * mean_a + mean_b * mean_b + kC1) * (variance_a + variance_b + kC2));
  return ((1 - similarity) / 2).clamp(0, 1);
}

torch::Tensor photometric_error(const torch::Tensor& estimate, const torch::Tensor& target) {
  const torch::Tensor structure = structural_difference(estimate, target).mean(1, true);
  const torch::Tensor colour = (estimate - target).abs().mean(1, true);
  return kStructureShare * structure + (1 - kStructureShare) * colour;
}

torch::Tensor photometric_loss(const torch::Tensor& target,
                               const std::vector<torch::Tensor>& warped,
                               const std::vector<torch::Tensor>& neighbours,
                               const torch::Tensor& weight, at::Generator& generator) {
  std::vector<torch::Tensor> errors;
  for (const torch::Tensor& view : warped) errors.push_back(photometric_error(view, target));
  for (const torch::Tensor& view : neighbours) {
    const torch::Tensor still = photometric_error(view, target);
    errors.push_back(still + torch::randn(still.sizes(), generator).to(still.device()) * kTieBreak);
  }
  const torch::Tensor least = std::get<0>(torch::cat(errors, 1).min(1));
  return (least.mean({1, 2}) * weight).mean();
}

torch::Tensor smoothness_loss(const torch::Tensor& inverse_depth, const torch::Tensor& image) {
  const torch::Tensor normalised = inverse_depth / (inverse_depth.mean({2, 3}, true) + 1e-7);
  torch::Tensor total = torch::zeros({}, inverse_depth.options());
  for (const std::int64_t axis : {3, 2}) {
    const torch::Tensor edge = difference(image, axis).abs().mean(1, true);
    total = total + (difference(normalised, axis).abs() * torch::exp(-edge)).mean();
  }
  return total;
}

}  // namespace lcdm::model
