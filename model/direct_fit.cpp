#include "model/direct_fit.h"

namespace lcdm::model {
namespace {

namespace F = torch::nn::functional;

constexpr std::int64_t kEvery = 5;  // pixel, in both directions: neighbours say the same
constexpr double kRidge = 1e-4;     // of the mean square, against channels that are all alike

// What the convolution sees of every `kEvery`th pixel, and 1 for its bias: [pixels, 9 C + 1].
torch::Tensor rows_of(const torch::Tensor& condition) {
  const torch::Tensor windows =
      F::unfold(condition, F::UnfoldFuncOptions(3).padding(1).stride(kEvery));
  const torch::Tensor rows = windows.transpose(1, 2).reshape({-1, windows.size(1)});
  return torch::cat({rows, torch::ones({rows.size(0), 1}, rows.options())}, 1).to(torch::kFloat64);
}

torch::Tensor answers_of(const torch::Tensor& variable) {
  return variable.slice(2, 0, variable.size(2), kEvery)
      .slice(3, 0, variable.size(3), kEvery)
      .reshape({-1, 1})
      .to(torch::kFloat64);
}

}  // namespace

void fit_direct(DepthNetwork& network, const std::vector<torch::Tensor>& pictures) {
  const torch::NoGradGuard no_grad;
  const bool was_training = network->is_training();
  network->eval();
  torch::Tensor squares, products;  // of the normal equations
  for (const torch::Tensor& picture : pictures) {
    const torch::Tensor condition = network->condition_of(picture);
    const torch::Tensor rows = rows_of(condition);
    const torch::Tensor answers =
        answers_of(network->sample(condition, static_cast<int>(network->config.steps.size())));
    const torch::Tensor square = rows.t().matmul(rows);
    const torch::Tensor product = rows.t().matmul(answers);
    squares = squares.defined() ? squares + square : square;
    products = products.defined() ? products + product : product;
  }
  squares.diagonal().add_(kRidge * squares.diagonal().mean());
  const torch::Tensor solution = torch::linalg_solve(squares, products).to(torch::kFloat32);
  torch::nn::Conv2d& direct = network->direct;
  direct->weight.copy_(solution.slice(0, 0, -1).reshape(direct->weight.sizes()));
  direct->bias.copy_(solution[-1]);
  network->train(was_training);
}

}  // namespace lcdm::model
