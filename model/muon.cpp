#include "model/muon.h"

#include <algorithm>
#include <cmath>

namespace lcdm::model {
namespace {

constexpr double kMomentum = 0.95;
constexpr int kIterations = 5;
constexpr double kA = 3.4445;  // of x -> a x + b x^3 + c x^5, steep at 0
constexpr double kB = -4.7750;
constexpr double kC = 2.0315;
constexpr double kRms = 0.2;  // what AdamW's changes come to

}  // namespace

torch::Tensor orthogonalised(const torch::Tensor& matrices) {
  const bool tall = matrices.size(1) > matrices.size(2);
  torch::Tensor x = tall ? matrices.transpose(1, 2) : matrices;
  x = x / (x.norm(2, {1, 2}, true) + 1e-7);
  for (int i = 0; i < kIterations; ++i) {
    const torch::Tensor square = torch::bmm(x, x.transpose(1, 2));
    const torch::Tensor factor = torch::baddbmm(square, square, square, kB, kC);
    x = torch::baddbmm(x, factor, x, kA);
  }
  return tall ? x.transpose(1, 2) : x;
}

bool is_matrix(const torch::Tensor& parameter) {
  return parameter.dim() >= 2 && parameter.size(0) >= 8 &&
         parameter.numel() / parameter.size(0) >= 16;
}

std::vector<torch::Tensor> muon_updates(const std::vector<torch::Tensor>& gradients,
                                        const std::vector<torch::Tensor>& momenta) {
  at::_foreach_mul_(momenta, kMomentum);
  at::_foreach_add_(momenta, gradients);
  std::vector<torch::Tensor> ahead;  // Nesterov's
  ahead.reserve(gradients.size());
  for (std::size_t i = 0; i < gradients.size(); ++i) {
    ahead.push_back((gradients[i] + momenta[i] * kMomentum).flatten(1));
  }
  const torch::Tensor matrices = torch::stack(ahead);
  const auto longer = static_cast<double>(std::max(matrices.size(1), matrices.size(2)));
  const torch::Tensor changes = orthogonalised(matrices) * (-kRms * std::sqrt(longer));
  std::vector<torch::Tensor> updates;
  updates.reserve(gradients.size());
  for (std::size_t i = 0; i < gradients.size(); ++i) {
    updates.push_back(changes[static_cast<std::int64_t>(i)].reshape(gradients[i].sizes()));
  }
  return updates;
}

}  // namespace lcdm::model
