// The optimiser's two rules: what a step of each is, how far gradient and weights are held back,
// and that threads do not change it.
#include "model/optimizer.h"

#include <cmath>
#include <gtest/gtest.h>
#include <map>
#include <memory>
#include <tuple>

#include "model/learned_cameras.h"
#include "model/muon.h"

namespace lcdm::model {
namespace {

// [rows, columns] with singular values from 1 down to 1e-2: as gradients are, ruled by a few.
torch::Tensor uneven(std::int64_t rows, std::int64_t columns) {
  const auto [u, s, v] = torch::linalg_svd(torch::randn({rows, columns}), false);
  return torch::matmul(u * torch::logspace(0, -2, s.size(0)), v);
}

// torch::linalg_svd, LAPACK's, is the reference.
class Orthogonalised : public testing::TestWithParam<std::tuple<int, int>> {};

TEST_P(Orthogonalised, KeepsSingularVectorsAndMakesTheirValuesAboutOne) {
  torch::manual_seed(1);
  const auto [rows, columns] = GetParam();
  const torch::Tensor matrix = uneven(rows, columns);
  const auto [u, s, v] = torch::linalg_svd(matrix, false);
  const torch::Tensor in_their_base =
      torch::matmul(torch::matmul(u.t(), orthogonalised(matrix.unsqueeze(0))[0]), v.t());
  const torch::Tensor values = in_their_base.diag();
  EXPECT_GT(values.min().item<double>(), 0.5);
  EXPECT_LT(values.max().item<double>(), 1.25);
  EXPECT_LT((in_their_base - values.diag()).abs().max().item<double>(), 1e-3);
}

INSTANTIATE_TEST_SUITE_P(Shapes, Orthogonalised,
                         testing::Values(std::tuple{8, 16}, std::tuple{48, 432},
                                         std::tuple{144, 48}, std::tuple{64, 64}));

TEST(Muon, IsForMatricesAndNotForFiltersOfOneChannelNormsAndTheLastLayer) {
  EXPECT_TRUE(is_matrix(torch::zeros({16, 3, 3, 3})));
  EXPECT_TRUE(is_matrix(torch::zeros({192, 64})));
  EXPECT_FALSE(is_matrix(torch::zeros({64, 1, 3, 3}))) << "a depthwise filter";
  EXPECT_FALSE(is_matrix(torch::zeros({64}))) << "a bias";
  EXPECT_FALSE(is_matrix(torch::zeros({1, 16, 3, 3}))) << "one output";
}

// A learning rate means for a matrix what it means for what AdamW moves.
TEST(Muon, MovesAMatrixAsFarAsAdamWWould) {
  torch::manual_seed(1);
  for (const double size : {1e-6, 1.0, 1e6}) {
    const torch::Tensor update =
        muon_updates({torch::randn({32, 16, 3, 3}) * size}, {torch::zeros({32, 16, 3, 3})})[0];
    const double rms = update.square().mean().sqrt().item<double>();
    EXPECT_GT(rms, 0.15) << size;
    EXPECT_LT(rms, 0.25) << size;
  }
}

// Nesterov's momentum of .95: the second step has seen both gradients.
TEST(Muon, RemembersItsGradients) {
  torch::manual_seed(2);
  const torch::Tensor first = torch::randn({24, 48});
  const torch::Tensor second = torch::randn({24, 48});
  const torch::Tensor momentum = torch::zeros({24, 48});
  muon_updates({first}, {momentum});
  const torch::Tensor update = muon_updates({second}, {momentum})[0];
  const torch::Tensor ahead = second + 0.95 * (0.95 * first + second);
  const torch::Tensor expected = orthogonalised(ahead.unsqueeze(0))[0] * (-0.2 * std::sqrt(48.0));
  EXPECT_TRUE(torch::allclose(update, expected, 1e-4, 1e-5));
}

TEST(Muon, ChangesManyMatricesAsItChangesEachAlone) {
  torch::manual_seed(5);
  std::vector<torch::Tensor> gradients, momenta;
  for (int i = 0; i < 3; ++i) {
    gradients.push_back(torch::randn({24, 6, 3, 3}));
    momenta.push_back(torch::randn({24, 6, 3, 3}));
  }
  std::vector<torch::Tensor> alone;
  for (std::size_t i = 0; i < gradients.size(); ++i) {
    alone.push_back(muon_updates({gradients[i]}, {momenta[i].clone()})[0]);
  }
  const std::vector<torch::Tensor> together = muon_updates(gradients, momenta);
  for (std::size_t i = 0; i < gradients.size(); ++i) {
    EXPECT_TRUE(torch::allclose(together[i], alone[i], 1e-4, 1e-6)) << i;
  }
}

struct TwoLayersImpl : torch::nn::Module {
  TwoLayersImpl() {
    depth = register_module("depth", torch::nn::Linear(24, 16));
    depth->register_parameter("table", torch::ones({150, 16}));
    pose = register_module("pose", torch::nn::Linear(24, 16));
  }
  torch::nn::Linear depth = nullptr;
  torch::nn::Linear pose = nullptr;
};
TORCH_MODULE(TwoLayers);

// One step at a rate of .01 from the same weights and gradients.
TwoLayers after_a_step(OptimizerKind kind, int threads) {
  torch::manual_seed(3);
  TwoLayers layers;
  for (torch::Tensor& parameter : layers->parameters()) {
    parameter.mutable_grad() = torch::randn_like(parameter);
  }
  Optimizer optimizer(kind, *layers, 0.01, threads);
  optimizer.step([](const std::string&) { return 0.01; });
  return layers;
}

bool same(const TwoLayers& a, const TwoLayers& b, const std::string& name) {
  return torch::equal(a->named_parameters()[name], b->named_parameters()[name]);
}

TEST(Optimizer, GivesMuonTheDepthNetworksMatricesOnly) {
  const TwoLayers adamw = after_a_step(OptimizerKind::kAdamW, 1);
  const TwoLayers muon = after_a_step(OptimizerKind::kMuon, 1);
  EXPECT_FALSE(same(adamw, muon, "depth.weight"));
  EXPECT_TRUE(same(adamw, muon, "depth.bias"));
  EXPECT_TRUE(same(adamw, muon, "pose.weight"));
}

// An embedding is a table, not a map: most of its rows have no gradient in a step.
TEST(Optimizer, LeavesEmbeddingsToAdamW) {
  const TwoLayers adamw = after_a_step(OptimizerKind::kAdamW, 1);
  const TwoLayers muon = after_a_step(OptimizerKind::kMuon, 1);
  ASSERT_TRUE(is_matrix(muon->depth->named_parameters()["table"]));
  EXPECT_TRUE(same(adamw, muon, "depth.table"));
}

// Decay would pull them to what was assumed.
TEST(Optimizer, LeavesLearnedFocalLengthsWhereNothingPullsThem) {
  LearnedCameras cameras(2);
  const torch::NoGradGuard no_grad;
  cameras->log_focal.fill_(0.2);
  cameras->log_focal.mutable_grad() = torch::zeros_like(cameras->log_focal);
  Optimizer optimizer(OptimizerKind::kAdamW, *cameras, 0.5, 1);
  optimizer.step([](const std::string&) { return 0.1; });
  EXPECT_TRUE((cameras->log_focal == 0.2F).all().item<bool>());
}

// LibTorch's own AdamW is the reference; it is told to decay matrices alone.
void expect_steps_of_adamw(double weight_decay) {
  torch::manual_seed(4);
  TwoLayers ours;
  TwoLayers theirs;
  std::vector<torch::Tensor> matrices, vectors;
  for (const auto& item : ours->named_parameters()) {
    const torch::NoGradGuard no_grad;
    const torch::Tensor twin = theirs->named_parameters()[item.key()];
    twin.copy_(item.value());
    (twin.dim() > 1 ? matrices : vectors).push_back(twin);
  }
  Optimizer optimizer(OptimizerKind::kAdamW, *ours, weight_decay, 2);
  const auto options = [](double decay) {
    return std::make_unique<torch::optim::AdamWOptions>(
        torch::optim::AdamWOptions(0.01).weight_decay(decay));
  };
  const std::vector<torch::optim::OptimizerParamGroup> groups = {{matrices, options(weight_decay)},
                                                                 {vectors, options(0)}};
  torch::optim::AdamW reference(groups);
  for (int i = 0; i < 3; ++i) {
    for (const auto& item : ours->named_parameters()) {
      const torch::Tensor gradient = torch::randn_like(item.value());
      theirs->named_parameters()[item.key()].mutable_grad() = gradient.clone();
      ours->named_parameters()[item.key()].mutable_grad() = gradient;
    }
    optimizer.step([](const std::string&) { return 0.01; });
    reference.step();
  }
  for (const auto& item : ours->named_parameters()) {
    EXPECT_TRUE(torch::allclose(item.value(), theirs->named_parameters()[item.key()], 1e-5, 1e-6))
        << item.key();
  }
}

TEST(Optimizer, IsAdamW) { expect_steps_of_adamw(0); }

// Three steps take 3e-3 of a matrix, a hundred times what is let pass.
TEST(Optimizer, IsAdamWThatDecaysMatricesApartFromTheirGradients) { expect_steps_of_adamw(0.1); }

// Nothing else pulls: each shrinks by its own rate times the decay, whichever rule moves it.
TEST(Optimizer, ShrinksMatricesAndNoVectorsWhereGradientsAreZero) {
  for (const OptimizerKind kind : {OptimizerKind::kAdamW, OptimizerKind::kMuon}) {
    torch::manual_seed(6);
    TwoLayers layers;
    std::map<std::string, torch::Tensor> before;
    for (auto& item : layers->named_parameters()) {
      before[item.key()] = item.value().detach().clone();
      item.value().mutable_grad() = torch::zeros_like(item.value());
    }
    Optimizer optimizer(kind, *layers, 0.5, 2);
    optimizer.step([](const std::string& name) { return name.starts_with("depth.") ? 0.1 : 0.2; });
    const std::map<std::string, double> kept = {{"depth.weight", 0.95},
                                                {"depth.bias", 1},
                                                {"depth.table", 0.95},
                                                {"pose.weight", 0.9},
                                                {"pose.bias", 1}};
    for (const auto& [name, share] : kept) {
      const torch::Tensor now = layers->named_parameters()[name];
      EXPECT_TRUE(torch::allclose(now, before.at(name) * share, 1e-6, 0))
          << name << ", optimiser " << static_cast<int>(kind);
    }
  }
}

// So is the head until it joins: not even decay is to touch it.
TEST(Optimizer, LeavesWhatHasNoGradientAsItIs) {
  for (const OptimizerKind kind : {OptimizerKind::kAdamW, OptimizerKind::kMuon}) {
    TwoLayers layers;
    const torch::Tensor before = layers->depth->weight.detach().clone();
    layers->pose->weight.mutable_grad() = torch::ones_like(layers->pose->weight);
    Optimizer optimizer(kind, *layers, 0.5, 1);
    optimizer.step([](const std::string&) { return 0.1; });
    EXPECT_TRUE(torch::equal(layers->depth->weight, before)) << static_cast<int>(kind);
  }
}

// 3 in one layer and 4 in the other: a norm of 5.
TEST(Optimizer, ClipsTheCommonNormOfAllGradients) {
  TwoLayers layers;
  Optimizer optimizer(OptimizerKind::kMuon, *layers, 0, 1);
  EXPECT_EQ(optimizer.clip(1), 0) << "nothing has a gradient";
  torch::Tensor of_weight = torch::zeros_like(layers->depth->weight);
  torch::Tensor of_bias = torch::zeros_like(layers->pose->bias);
  of_weight[2][5] = 3;
  of_bias[7] = -4;
  layers->depth->weight.mutable_grad() = of_weight.clone();
  layers->pose->bias.mutable_grad() = of_bias.clone();
  const auto expect_times = [&](double factor) {
    EXPECT_TRUE(torch::allclose(layers->depth->weight.grad(), of_weight * factor, 1e-6, 0));
    EXPECT_TRUE(torch::allclose(layers->pose->bias.grad(), of_bias * factor, 1e-6, 0));
    EXPECT_FALSE(layers->pose->weight.grad().defined());
  };
  EXPECT_NEAR(optimizer.clip(6), 5, 1e-6);
  expect_times(1);
  EXPECT_NEAR(optimizer.clip(2), 5, 1e-6) << "the norm before";
  expect_times(0.4);
  EXPECT_NEAR(optimizer.clip(6), 2, 1e-6);
}

TEST(Optimizer, DoesNotDependOnTheNumberOfThreads) {
  const TwoLayers one = after_a_step(OptimizerKind::kMuon, 1);
  const TwoLayers three = after_a_step(OptimizerKind::kMuon, 3);
  for (const auto& item : one->named_parameters()) {
    EXPECT_TRUE(same(one, three, item.key())) << item.key();
  }
}

}  // namespace
}  // namespace lcdm::model
