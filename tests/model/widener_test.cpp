// A larger network that starts as a smaller one: model/widener.h.
#include "model/widener.h"

#include <gtest/gtest.h>

namespace lcdm::model {
namespace {

ModelConfig config_of(EncoderKind encoder) {
  ModelConfig config;
  config.encoder = encoder;
  config.start = StartKind::kZeros;
  return config;
}

// Statistics, affine parts and biases that matter.
DepthNetwork shaken(EncoderKind encoder) {
  DepthNetwork network(config_of(encoder));
  const torch::NoGradGuard no_grad;
  for (auto& item : network->named_parameters()) {
    if (item.value().dim() == 1) item.value().add_(torch::randn_like(item.value()) * 0.1);
  }
  measure_statistics(network, *network, Answers::kKeep, {torch::randn({2, 3, 64, 96}) * 0.7 + 0.2});
  network->eval();
  return network;
}

torch::Tensor answer(DepthNetwork& network, const torch::Tensor& rgb) {
  const torch::NoGradGuard no_grad;
  return network->sample(network->condition_of(rgb), 2);
}

class Widen : public testing::TestWithParam<std::pair<EncoderKind, EncoderKind>> {};

TEST_P(Widen, ComputesWhatTheNarrowNetworkDoes) {
  torch::manual_seed(21);
  DepthNetwork narrow = shaken(GetParam().first);
  DepthNetwork wide(config_of(GetParam().second));
  const Status status = widen(narrow, wide);
  ASSERT_TRUE(status) << status.text();
  wide->eval();
  const torch::Tensor rgb = torch::randn({1, 3, 64, 96});
  const torch::Tensor expected = answer(narrow, rgb);
  EXPECT_LT((answer(wide, rgb) - expected).abs().max().item<float>(),
            0.05 * expected.std().item<float>());
}

// What is new is not only carried along: a step of training reaches it.
TEST_P(Widen, LearnsInItsNewChannels) {
  torch::manual_seed(22);
  DepthNetwork narrow = shaken(GetParam().first);
  DepthNetwork wide(config_of(GetParam().second));
  ASSERT_TRUE(widen(narrow, wide));
  wide->train();
  const auto loss = [&] {
    return wide->condition_of(torch::randn({2, 3, 64, 96})).square().mean();
  };
  torch::optim::SGD first_step(wide->parameters(), 0.1);
  loss().backward();  // from the zeros of the start
  first_step.step();
  first_step.zero_grad();
  loss().backward();
  for (const auto& item : wide->encoder->named_parameters()) {
    const torch::Tensor& gradient = item.value().grad();
    ASSERT_TRUE(gradient.defined()) << item.key();
    const torch::Tensor last = gradient.narrow(0, gradient.size(0) - 1, 1);
    EXPECT_GT(last.abs().max().item<float>(), 0) << item.key();
  }
}

INSTANTIATE_TEST_SUITE_P(All, Widen,
                         testing::Values(std::pair(EncoderKind::kXxs, EncoderKind::kXs),
                                         std::pair(EncoderKind::kXxs, EncoderKind::kS),
                                         std::pair(EncoderKind::kXs, EncoderKind::kS)));

TEST(WidenError, ALargerEncoderDoesNotFit) {
  DepthNetwork narrow(config_of(EncoderKind::kXs));
  DepthNetwork wide(config_of(EncoderKind::kXxs));
  EXPECT_EQ(widen(narrow, wide).code(), StatusCode::kInvalidInput);
}

// Before: normalisation by any numbers. After: what goes out of every batch norm has its own mean
// and deviation as statistics, and the answer is the same.
TEST(MeasureStatistics, ChangesNoAnswer) {
  torch::manual_seed(23);
  DepthNetwork network = shaken(EncoderKind::kXxs);
  const torch::Tensor rgb = torch::randn({4, 3, 64, 96});
  const torch::Tensor before = answer(network, rgb);
  measure_statistics(network, *network, Answers::kKeep, {torch::randn({4, 3, 96, 64}), rgb});
  EXPECT_LT((answer(network, rgb) - before).abs().max().item<float>(),
            1e-3 * before.std().item<float>());

  measure_statistics(network, *network, Answers::kKeep, {rgb});
  const torch::NoGradGuard no_grad;
  const Norm& norm = network->encoder->stem->bn;
  const torch::Tensor seen = network->encoder->stem->conv->forward(rgb);
  EXPECT_LT((norm->running_mean - seen.mean({0, 2, 3})).abs().max().item<float>(), 1e-5);
  EXPECT_LT((norm->running_var - seen.var({0, 2, 3}, true)).abs().max().item<float>(), 1e-4);
  EXPECT_FALSE(network->is_training());
}

}  // namespace
}  // namespace lcdm::model
