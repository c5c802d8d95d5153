// The network's shapes, size and sampler, and what an export keeps of them.
#include "model/network.h"

#include <cmath>
#include <gtest/gtest.h>
#include <map>
#include <vector>

#include "model/checkpoint.h"
#include "model/depth_code.h"
#include "model/direct_fit.h"
#include "model/exporter.h"
#include "model/folded_net.h"
#include "model/safetensors.h"
#include "model/unfolder.h"
#include "tests/support/temporary_folder.h"

namespace lcdm::model {
namespace {

ModelConfig config_of(EncoderKind encoder, PresetKind preset = PresetKind::kLcdm) {
  ModelConfig config;
  config.encoder = encoder;
  config.preset = preset;
  if (preset == PresetKind::kPaper) config.steps = {75, 0};
  return config;
}

std::int64_t parameters_of(const torch::nn::Module& module) {
  std::int64_t count = 0;
  for (const torch::Tensor& parameter : module.parameters()) count += parameter.numel();
  return count;
}

double millions(EncoderKind encoder) {
  const DepthNetwork network(config_of(encoder));
  return static_cast<double>(parameters_of(*network->encoder) + parameters_of(*network->decoder) +
                             parameters_of(*network->head)) /
         1e6;
}

TEST(DepthNetwork, HasTheSizesOfTheSpecification) {
  EXPECT_NEAR(millions(EncoderKind::kXxs), 1.73, 0.01);
  EXPECT_NEAR(millions(EncoderKind::kXs), 2.82, 0.01);
  EXPECT_NEAR(millions(EncoderKind::kS), 6.20, 0.01);
}

TEST(DepthNetwork, GivesFullResolutionAlsoWithOddRows) {
  DepthNetwork network(config_of(EncoderKind::kXxs));
  network->eval();
  const torch::NoGradGuard no_grad;
  const auto taps = network->encoder->forward(torch::randn({1, 3, 96, 64}));
  EXPECT_EQ(taps[4].size(2), 3);  // odd at 1/32
  const torch::Tensor condition = network->condition_of(torch::randn({1, 3, 96, 64}));
  EXPECT_EQ(condition.sizes(), (std::vector<std::int64_t>{1, 16, 96, 64}));
  EXPECT_EQ(network->sample(condition, 2).sizes(), (std::vector<std::int64_t>{1, 1, 96, 64}));
}

TEST(Patches, FoldUndoesUnfold) {
  const torch::Tensor x = torch::randn({2, 5, 6, 8});
  const torch::Tensor tokens = unfold_patches(x);
  EXPECT_EQ(tokens.sizes(), (std::vector<std::int64_t>{8, 12, 5}));
  EXPECT_TRUE(torch::equal(fold_patches(tokens, 2, 6, 8), x));
  // Position 1 (row 0, column 1) of the first image, first patch.
  EXPECT_TRUE(torch::equal(tokens[1][0], x[0].index({torch::indexing::Slice(), 0, 1})));
}

// MODEL.md section 3: at abar = 0 the first v step gives sqrt(.456) x0_hat + sqrt(.544) x_149 with
// x0_hat = -v.
TEST(Sampler, FirstStepIsTheIdentityOfZeroTerminalSnr) {
  torch::manual_seed(1);
  DepthNetwork network(config_of(EncoderKind::kXxs));
  network->eval();
  const torch::NoGradGuard no_grad;
  const torch::Tensor condition = torch::randn({1, 16, 32, 32});
  const torch::Tensor start = network->start(32, 32);
  const torch::Tensor v =
      network->head->forward(condition, start, torch::tensor({149}), 0, Statistics::kLeave);
  const torch::Tensor once = network->sample(condition, 1);
  EXPECT_LT((once + v).abs().max().item<float>(), 1e-6);

  const torch::Tensor d1 = std::sqrt(0.456) * -v + std::sqrt(0.544) * start;
  const torch::Tensor v2 =
      network->head->forward(condition, d1, torch::tensor({74}), 1, Statistics::kLeave);
  const torch::Tensor d0 = std::sqrt(0.456) * d1 - std::sqrt(0.544) * v2;
  EXPECT_LT((network->sample(condition, 2) - d0).abs().max().item<float>(), 5e-3);
}

// MODEL.md section 3: with leading spacing the last update of `paper` moves the value by at most
// 0.01 times the difference of two predictions: two steps are really one.
TEST(Sampler, SecondStepOfPaperDoesNothing) {
  torch::manual_seed(2);
  DepthNetwork network(config_of(EncoderKind::kXxs, PresetKind::kPaper));
  network->eval();
  const torch::NoGradGuard no_grad;
  const torch::Tensor condition = torch::randn({1, 16, 32, 32});
  const torch::Tensor start = network->start(32, 32);
  const torch::Tensor e1 =
      network->head->forward(condition, start, torch::tensor({75}), 0, Statistics::kLeave);
  const double a = 0.677;  // abar_75
  const torch::Tensor x0 = (start - std::sqrt(1 - a) * e1) / std::sqrt(a);
  const torch::Tensor d0 = network->sample(condition, 2);
  const torch::Tensor e2_bound = 0.02 * (e1.abs().max() + 1);
  EXPECT_LT((d0 - x0).abs().max().item<float>(), e2_bound.item<float>());
}

// Gives every BatchNorm statistics that matter.
void shake_norms(DepthNetwork& network) {
  const torch::NoGradGuard no_grad;
  for (const auto& module : network->modules()) {
    if (auto* norm = module->as<Norm>()) {
      norm->running_mean.normal_(0, 0.1);
      norm->running_var.uniform_(0.7, 1.4);
      norm->weight.uniform_(0.8, 1.2);
      norm->bias.normal_(0, 0.1);
    }
  }
}

class Export : public testing::TestWithParam<PresetKind> {};

TEST_P(Export, ComputesTheSameDepth) {
  torch::manual_seed(11);
  DepthNetwork network(config_of(EncoderKind::kXxs, GetParam()));
  network->config.name = "a \"quoted\" name";
  network->config.licence = "none";
  network->config.card = "one paragraph";
  shake_norms(network);
  network->eval();
  const test::TemporaryFolder folder;
  const std::string path = folder.file("model.safetensors");
  ASSERT_TRUE(export_network(network, path));
  const Result<ModelFile> file = ModelFile::load(path);
  ASSERT_TRUE(file) << file.status().text();
  EXPECT_EQ(file->config().name, network->config.name);
  EXPECT_EQ(file->config().card, network->config.card);

  const torch::NoGradGuard no_grad;
  const torch::Tensor rgb = torch::randn({1, 3, 64, 96});
  const torch::Tensor mine =
      depth_of_variable(network->sample(network->condition_of(rgb), 2), network->config);
  const torch::Tensor theirs = FoldedNet(*file).forward(rgb);
  EXPECT_LT(((mine - theirs) / mine).abs().max().item<float>(), 0.02);  // half precision
  EXPECT_LT(((mine - theirs) / mine).abs().mean().item<float>(), 0.004);
}

TEST(ExportedTexts, ThatTheDeviceWouldRefuseAreRefusedAndTheOldFileStays) {
  DepthNetwork network(config_of(EncoderKind::kXxs, PresetKind::kLcdm));
  network->config.name = "tiny";
  network->config.licence = "none";
  network->eval();
  const test::TemporaryFolder folder;
  const std::string path = folder.file("model.safetensors");
  ASSERT_TRUE(export_network(network, path));
  network->config.card = "two\nlines";
  const Status refused = export_network(network, path);
  EXPECT_FALSE(refused);
  EXPECT_NE(std::string(refused.text()).find("`card`"), std::string::npos) << refused.text();
  EXPECT_TRUE(ModelFile::load(path));
}

TEST_P(Export, OfSeveralNetworksIsTheMeanOfTheirWeightsAndStatistics) {
  std::vector<DepthNetwork> networks;
  for (const std::uint64_t seed : {5U, 6U}) {
    torch::manual_seed(seed);
    networks.emplace_back(config_of(EncoderKind::kXxs, GetParam()));
    networks.back()->config.licence = "none";
    shake_norms(networks.back());
    networks.back()->eval();
  }
  const test::TemporaryFolder folder;
  const std::string path = folder.file("model.safetensors");
  ASSERT_TRUE(export_mean(networks, path));
  const Result<TensorFile> file = read_tensors(path);
  ASSERT_TRUE(file) << file.status().text();
  std::map<std::string, torch::Tensor> a;
  std::map<std::string, torch::Tensor> b;
  collect(*networks[0], "", a);
  collect(*networks[1], "", b);
  const auto mean = [&](const std::string& name) { return (a.at(name) + b.at(name)) / 2; };
  const auto expect_near = [&](const std::string& name, const torch::Tensor& expected) {
    const torch::Tensor actual = file->tensors.at(name).to(torch::kFloat32);
    EXPECT_TRUE(torch::allclose(actual, expected, 1e-3, 1e-6)) << name;
  };
  ASSERT_EQ(file->tensors.size(), fold_network(networks[0]).size());
  int untouched = 0;
  for (const auto& [name, tensor] : file->tensors) {
    if (!a.contains(name)) continue;  // something is folded into it
    expect_near(name, mean(name));
    ++untouched;
  }
  EXPECT_GT(untouched, 100);
  // Where a norm is folded in, it is the mean norm, of the mean statistics.
  const std::string stem = "encoder.stem.";
  const torch::Tensor scale =
      mean(stem + "bn.weight") / (mean(stem + "bn.running_var") + 1e-5).sqrt();
  expect_near(stem + "weight", mean(stem + "conv.weight") * scale.reshape({-1, 1, 1, 1}));
  expect_near(stem + "bias", mean(stem + "bn.bias") - mean(stem + "bn.running_mean") * scale);
}

TEST(ExportedMeans, AreOfNetworksThatComputeAlike) {
  const test::TemporaryFolder folder;
  const std::string path = folder.file("model.safetensors");
  const DepthNetwork one(config_of(EncoderKind::kXxs, PresetKind::kLcdm));
  ModelConfig config = one->config;
  config.variable_mean = 1;
  for (const ModelConfig& other : {config, config_of(EncoderKind::kXs, PresetKind::kLcdm)}) {
    const Status status = export_mean({one, DepthNetwork(other)}, path);
    EXPECT_EQ(status.code(), StatusCode::kInvalidInput);
    EXPECT_NE(std::string(status.text()).find("averaged"), std::string::npos) << status.text();
  }
  EXPECT_EQ(export_mean({}, path).code(), StatusCode::kInvalidInput);
}

// A model file that was unfolded and folded again is the same file, to rounding.
TEST_P(Export, IsUndoneForFineTuning) {
  torch::manual_seed(12);
  DepthNetwork network(config_of(EncoderKind::kXxs, GetParam()));
  network->config.variable_mean = 3.25;
  network->config.licence = "none";
  shake_norms(network);
  network->eval();
  const test::TemporaryFolder folder;
  const std::string path = folder.file("model.safetensors");
  ASSERT_TRUE(export_network(network, path));
  Result<DepthNetwork> again = unfold_model(path);
  ASSERT_TRUE(again) << again.status().text();
  EXPECT_EQ((*again)->config.variable_mean, 3.25);
  const auto expected = fold_network(network);
  const auto actual = fold_network(*again);
  ASSERT_EQ(actual.size(), expected.size());
  for (const auto& [name, tensor] : expected) {
    EXPECT_LT((actual.at(name) - tensor).abs().max().item<float>(), 2e-3) << name;
  }
  const torch::NoGradGuard no_grad;
  const torch::Tensor rgb = torch::randn({1, 3, 64, 96});
  const torch::Tensor before = network->sample(network->condition_of(rgb), 2);
  const torch::Tensor after = (*again)->sample((*again)->condition_of(rgb), 2);
  EXPECT_LT((before - after).abs().mean().item<float>(), 0.01);
}

// Learning rates are made for filters of the size they begin with; folding made them smaller.
TEST(Unfolder, GivesBackFiltersAsLargeAsNewOnes) {
  torch::manual_seed(12);
  DepthNetwork network(config_of(EncoderKind::kXxs, PresetKind::kLcdm));
  const torch::Tensor filters = network->encoder->stem->conv->weight.clone();
  {
    const torch::NoGradGuard no_grad;
    network->encoder->stem->bn->weight.fill_(0.1);
  }
  const test::TemporaryFolder folder;
  const std::string path = folder.file("model.safetensors");
  ASSERT_TRUE(export_network(network, path));
  const Result<DepthNetwork> again = unfold_model(path);
  ASSERT_TRUE(again) << again.status().text();
  const double size = (*again)->encoder->stem->conv->weight.square().mean().sqrt().item<double>();
  const double as_new = filters.square().mean().sqrt().item<double>();
  EXPECT_NEAR(size, as_new, 0.2 * as_new);
}

double distance_to_sampler(DepthNetwork& network, const torch::Tensor& rgb) {
  const torch::NoGradGuard no_grad;
  const torch::Tensor condition = network->condition_of(rgb);
  return (network->sample(condition, 0) - network->sample(condition, 2))
      .square()
      .mean()
      .item<double>();
}

// A head without noise that only adds: but for the picture's border its answer is a convolution of
// the condition.
void make_linear(DepthNetwork& network) {
  network->config.start = StartKind::kZeros;
  Head& head = network->head;
  for (torch::Tensor tensor :
       {head->embed->weight, head->embed->bias, head->time_embed, head->conv1->weight}) {
    tensor.zero_();
  }
  for (int c = 0; c < network->config.condition_channels; ++c) head->conv1->weight[c][c][1][1] = 1;
  head->conv1->bias.fill_(1);  // ELU gives more than -1, so ReLU lets all through
}

TEST(DirectFit, FindsTheConvolutionThatASamplerIs) {
  torch::manual_seed(4);
  DepthNetwork network(config_of(EncoderKind::kXxs, PresetKind::kLcdm));
  network->eval();
  const torch::NoGradGuard no_grad;
  make_linear(network);
  const torch::Tensor rgb = torch::randn({4, 3, 96, 128});
  const double before = distance_to_sampler(network, rgb);
  fit_direct(network, {rgb.slice(0, 0, 2), rgb.slice(0, 2, 4)});
  EXPECT_LT(distance_to_sampler(network, rgb), 0.05 * before);
}

INSTANTIATE_TEST_SUITE_P(Presets, Export, testing::Values(PresetKind::kLcdm, PresetKind::kPaper));

}  // namespace
}  // namespace lcdm::model
