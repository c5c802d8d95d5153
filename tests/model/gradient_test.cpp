// What the training follows downhill, against central differences: in double, but where the network
// starts from floats.
#include <cmath>
#include <functional>
#include <gtest/gtest.h>
#include <string>
#include <vector>

#include "model/depth_code.h"
#include "model/geometry.h"
#include "model/losses.h"
#include "model/network.h"
#include "model/self_supervision.h"

namespace lcdm::model {
namespace {

// What `loss` depends on, by a name to report.
struct Input {
  std::string name;
  torch::Tensor values;
};

struct Precision {
  double change;  // of the loss, that a step of the differences makes
  double error;   // of a derivative, as a share of what one along a random direction comes to
};
// So short a step that losses' kinks are hardly ever within it.
constexpr Precision kDouble = {1e-8, 1e-5};

// A random direction sees every element, and each input has some of its own: a gradient too small
// would be lost beside the others'. `loss` reads `inputs`, which are moved in place.
void expect_gradient_of_differences(const std::function<torch::Tensor()>& loss,
                                    const std::vector<Input>& inputs, Precision precision) {
  constexpr int kDirections = 4;
  for (const Input& input : inputs) {
    torch::Tensor values = input.values;
    values.requires_grad_();
    values.mutable_grad() = torch::Tensor();
  }
  loss().backward();
  const torch::NoGradGuard no_grad;
  for (const Input& input : inputs) {
    torch::Tensor values = input.values;
    const torch::Tensor gradient = values.grad();
    ASSERT_TRUE(gradient.defined()) << input.name;
    const double norm = gradient.norm().item<double>();
    ASSERT_GT(norm, 0) << input.name;
    const double step = precision.change / norm;
    const torch::Tensor start = values.clone();
    for (int i = 0; i < kDirections; ++i) {
      const torch::Tensor direction = torch::randn_like(start);
      const auto loss_at = [&](double distance) {
        values.copy_(start + distance * direction);
        return loss().item<double>();
      };
      const double expected = (loss_at(step) - loss_at(-step)) / (2 * step);
      values.copy_(start);
      EXPECT_NEAR((gradient * direction).sum().item<double>(), expected, precision.error * norm)
          << input.name << ", direction " << i;
    }
  }
}

torch::Tensor uniform(std::vector<std::int64_t> shape) {
  return torch::rand(shape, torch::kFloat64);
}
torch::Tensor normal(std::vector<std::int64_t> shape) {
  return torch::randn(shape, torch::kFloat64);
}
torch::Tensor of_each(std::vector<double> values, std::vector<std::int64_t> shape) {
  return torch::tensor(values, torch::kFloat64).reshape(shape);
}

// Of random pictures each neighbour, warped or as it stands, is the best somewhere.
TEST(PhotometricLoss, GradientIsThatOfFiniteDifferences) {
  torch::manual_seed(1);
  const std::vector<std::int64_t> shape = {2, 3, 6, 7};
  const torch::Tensor target = uniform(shape);
  const torch::Tensor before = uniform(shape), after = uniform(shape);
  const std::vector<torch::Tensor> neighbours = {uniform(shape), uniform(shape)};
  const torch::Tensor weight = of_each({1, 0.5}, {2});
  const auto loss = [&] {
    at::Generator generator = at::detail::createCPUGenerator(3);  // the same tie-break
    return photometric_loss(target, {before, after}, neighbours, weight, generator);
  };
  expect_gradient_of_differences(loss, {{"before", before}, {"after", after}}, kDouble);
}

// All that a drive teaches goes this way: through both neighbours' views to depth, motion and focal
// lengths.
TEST(PhotometricLoss, GradientOfWhatMakesTheViewsIsThatOfFiniteDifferences) {
  torch::manual_seed(2);
  const std::vector<std::int64_t> shape = {2, 3, 6, 8};
  const torch::Tensor here = uniform(shape), earlier = uniform(shape), later = uniform(shape);
  const torch::Tensor depth = uniform({2, 1, 6, 8}) + 2;
  const torch::Tensor axis_angle = 0.05 * normal({2, 3});
  const torch::Tensor translation = 0.2 * normal({2, 3});
  const std::vector<std::int64_t> of_images = {2, 1, 1, 1};
  const Pinholes cameras = {of_each({7, 8}, of_images), of_each({6, 9}, of_images),
                            of_each({3.4, 3.6}, of_images), of_each({2.3, 2.6}, of_images)};
  const auto loss = [&] {
    const torch::Tensor points = back_project(depth, cameras);
    const auto view = [&](const torch::Tensor& picture, bool inverse) {
      const torch::Tensor motion = rigid_motion(axis_angle, translation, inverse);
      return sample_at(picture, project(points, motion, cameras));
    };
    at::Generator generator = at::detail::createCPUGenerator(3);
    return photometric_loss(here, {view(earlier, true), view(later, false)}, {earlier, later},
                            torch::ones({2}, torch::kFloat64), generator);
  };
  expect_gradient_of_differences(loss,
                                 {{"depth", depth},
                                  {"axis_angle", axis_angle},
                                  {"translation", translation},
                                  {"fx", cameras.fx},
                                  {"fy", cameras.fy}},
                                 kDouble);
}

TEST(SmoothnessLoss, GradientIsThatOfFiniteDifferences) {
  torch::manual_seed(3);
  const torch::Tensor inverse = uniform({2, 1, 5, 6}) + 0.5;
  const torch::Tensor image = uniform({2, 3, 5, 6});
  expect_gradient_of_differences([&] { return smoothness_loss(inverse, image); },
                                 {{"inverse depth", inverse}}, kDouble);
}

// A third of the pixels are unknown, and hold what must not be seen.
struct Maps {
  explicit Maps(std::vector<std::int64_t> shape)
      : log_depth(normal(shape)), mask(torch::rand(shape) < 0.67) {
    log_target = torch::where(mask, normal(shape), torch::full(shape, NAN, torch::kFloat64));
  }
  torch::Tensor log_depth, mask, log_target;
  torch::Tensor weight = of_each({1, 0.5}, {2});
};

TEST(LogDepthLoss, GradientIsThatOfFiniteDifferences) {
  torch::manual_seed(4);
  const Maps maps({2, 1, 5, 6});
  expect_gradient_of_differences(
      [&] { return log_depth_loss(maps.log_depth, maps.log_target, maps.mask, maps.weight); },
      {{"log depth", maps.log_depth}}, kDouble);
}

// Of 17 pixels a side the coarsest scale, every eighth, sees three.
TEST(GradientLoss, GradientIsThatOfFiniteDifferences) {
  torch::manual_seed(5);
  const Maps maps({2, 1, 17, 17});
  expect_gradient_of_differences(
      [&] { return gradient_loss(maps.log_depth, maps.log_target, maps.mask, maps.weight); },
      {{"log depth", maps.log_depth}}, kDouble);
}

ModelConfig small_config() {
  ModelConfig config;
  config.encoder = EncoderKind::kXxs;
  return config;
}

// What steers the head, and its weights, of sampler step `step`'s norm.
std::vector<Input> inputs_of(const Head& head, const torch::Tensor& condition, std::size_t step) {
  return {{"condition", condition},
          {"embed", head->embed->weight},
          {"time_embed", head->time_embed},
          {"conv1", head->conv1->weight},
          {"norm's weight", head->norm[step]->weight},
          {"norm's bias", head->norm[step]->bias},
          {"conv2", head->conv2->weight}};
}

// Both with the batch's own statistics and with frozen ones.
TEST(DenoisingLoss, GradientIsThatOfFiniteDifferences) {
  torch::manual_seed(6);
  DepthNetwork network(small_config());
  network->head->to(torch::kFloat64);
  const std::vector<std::int64_t> shape = {2, 1, 5, 6};
  const torch::Tensor condition = normal({2, 16, 5, 6});
  const Maps maps(shape);
  const torch::Tensor student = normal(shape);
  const DenoisingDraw draw{torch::tensor({90, 20}, torch::kLong), normal(shape), 1};
  for (const bool training : {true, false}) {
    SCOPED_TRACE(training ? "training" : "frozen");
    network->train(training);
    expect_gradient_of_differences(
        [&] {
          return denoising_loss(network, condition, maps.log_target, student, maps.mask,
                                maps.weight, draw);
        },
        inputs_of(network->head, condition, 1), kDouble);
  }
}

// The head starts from floats: the step is long enough for their rounding, and so moves a few of
// thousands of ReLUs over their kink.
TEST(Rollout, GradientOfDepthIsThatOfFiniteDifferences) {
  torch::manual_seed(7);
  DepthNetwork network(small_config());
  const torch::Tensor condition = torch::randn({2, 16, 8, 8});
  const torch::Tensor weight = normal({2, 1, 8, 8});
  for (const bool training : {true, false}) {
    SCOPED_TRACE(training ? "training" : "frozen");
    network->train(training);
    const auto loss = [&] {
      const torch::Tensor depth = depth_of_variable(network->sample(condition, 2), network->config);
      return (depth.to(torch::kFloat64) * weight).sum();
    };
    for (const std::size_t step : {0U, 1U}) {
      expect_gradient_of_differences(loss, inputs_of(network->head, condition, step), {1e-4, 0.05});
    }
  }
}

}  // namespace
}  // namespace lcdm::model
