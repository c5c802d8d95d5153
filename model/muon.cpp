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

torch::Tensor orthogonalised(const torch::Tensor& matrix) {
  const bool tall = matrix.size(0) > matrix.size(1);
  torch::Tensor x = tall ? matrix.t() : matrix;
  x = x / (x.norm() + 1e-7);
  for (int i = 0; i < kIterations; ++i) {
    const torch::Tensor square = torch::mm(x, x.t());
    const torch::Tensor factor = torch::addmm(square, square, square, kB, kC);
    x = torch::addmm(x, factor, x, kA);
  }
  return tall ? x.t() : x;
}

bool is_matrix(const torch::Tensor& parameter) {
  return parameter.dim() >= 2 && parameter.size(0) >= 8 &&
         parameter.numel() / parameter.size(0) >= 16;
}

torch::Tensor muon_update(const torch::Tensor& gradient, torch::Tensor& momentum) {
  momentum.mul_(kMomentum).add_(gradient);
  const torch::Tensor ahead = gradient + momentum * kMomentum;  // Nesterov's
  const torch::Tensor matrix = ahead.flatten(1);
  const auto longer = static_cast<double>(std::max(matrix.size(0), matrix.size(1)));
  return (orthogonalised(matrix) * (-kRms * std::sqrt(longer))).reshape(gradient.sizes());
}

}  // namespace lcdm::model
