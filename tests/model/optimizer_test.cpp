// The optimiser's two rules: what a step of each is, and that threads do not change it.
#include "model/optimizer.h"

#include <cmath>
#include <gtest/gtest.h>
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

// LibTorch's own AdamW is the reference.
TEST(Optimizer, IsAdamW) {
  torch::manual_seed(4);
  TwoLayers ours;
  TwoLayers theirs;
  for (const auto& item : ours->named_parameters()) {
    const torch::NoGradGuard no_grad;
    theirs->named_parameters()[item.key()].copy_(item.value());
  }
  Optimizer optimizer(OptimizerKind::kAdamW, *ours, 0, 2);
  torch::optim::AdamW reference(theirs->parameters(),
                                torch::optim::AdamWOptions(0.01).weight_decay(0));
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

TEST(Optimizer, DoesNotDependOnTheNumberOfThreads) {
  const TwoLayers one = after_a_step(OptimizerKind::kMuon, 1);
  const TwoLayers three = after_a_step(OptimizerKind::kMuon, 3);
  for (const auto& item : one->named_parameters()) {
    EXPECT_TRUE(same(one, three, item.key())) << item.key();
  }
}

}  // namespace
}  // namespace lcdm::model
