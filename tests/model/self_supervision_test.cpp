// The photometric and smoothness losses on figures worked by hand.
#include "model/self_supervision.h"

#include <gtest/gtest.h>

#include "model/geometry.h"
#include "model/learned_cameras.h"
#include "model/pose_net.h"

namespace lcdm::model {
namespace {

at::Generator generator() { return at::detail::createCPUGenerator(3); }

TEST(StructuralDifference, IsZeroForTheSamePicture) {
  const torch::Tensor x = torch::rand({1, 3, 12, 16});
  EXPECT_LT(structural_difference(x, x).abs().max().item<double>(), 1e-5);
}

// Flat pictures of 0.2 and 0.6: no variance, so (1 - (2 ab + C1) / (a^2 + b^2 + C1)) / 2.
TEST(StructuralDifference, OfFlatPicturesIsTheFormula) {
  const torch::Tensor a = torch::full({1, 1, 8, 8}, 0.2F);
  const torch::Tensor b = torch::full({1, 1, 8, 8}, 0.6F);
  const double expected = (1 - (2 * 0.12 + 1e-4) / (0.04 + 0.36 + 1e-4)) / 2;
  EXPECT_NEAR(structural_difference(a, b).mean().item<double>(), expected, 1e-4);
  EXPECT_NEAR(photometric_error(a, b).mean().item<double>(), 0.85 * expected + 0.15 * 0.4, 1e-4);
}

// x = .1 to .9 and y = x / 2 + .2 in a window of 3x3: means .5 and .45, variances 1/15 and 1/60,
// covariance 1/30; the similarity is .4501 x .067567 / (.4526 x .084233).
TEST(StructuralDifference, WeighsVarianceAndCovariance) {
  const torch::Tensor x = torch::arange(1, 10).to(torch::kFloat32).reshape({1, 1, 3, 3}) / 10;
  const torch::Tensor middle = structural_difference(x, x / 2 + 0.2)[0][0][1][1];
  EXPECT_NEAR(middle.item<double>(), 0.101148, 1e-5);
}

// The same x seen from its corner, where what lies beyond the border mirrors what lies within: .5
// .4 .5, .2 .1 .2, .5 .4 .5. Means 11/30 and 23/60, variances 1/45 and 1/180, covariance 1/90.
// Zeros outside, or the border again (.115), are others.
TEST(StructuralDifference, SeesItsOwnMirrorImageBeyondTheBorder) {
  const torch::Tensor x = torch::arange(1, 10).to(torch::kFloat32).reshape({1, 1, 3, 3}) / 10;
  const torch::Tensor all = structural_difference(x, x / 2 + 0.2);
  EXPECT_EQ(all.sizes(), x.sizes());
  EXPECT_NEAR(all[0][0][0][0].item<double>(), 0.097260, 1e-5);
}

TEST(PhotometricLoss, TakesTheBestOfTheNeighboursPixelByPixel) {
  const torch::Tensor target = torch::rand({1, 3, 16, 32});
  torch::Tensor left = target.clone();
  torch::Tensor right = target.clone();
  left.narrow(3, 16, 16).fill_(0);  // each sees one half, as where something stands in the way
  right.narrow(3, 0, 16).fill_(0);
  const torch::Tensor elsewhere = torch::zeros_like(target);
  at::Generator random = generator();
  const double loss =
      photometric_loss(target, {left, right}, {elsewhere, elsewhere}, torch::ones({1}), random)
          .item<double>();
  const double one =
      photometric_loss(target, {left}, {elsewhere}, torch::ones({1}), random).item<double>();
  EXPECT_LT(loss, 0.25 * one);
}

// The same picture, once with its neighbours in time and once without.
TEST(PhotometricLoss, AnImageWithoutNeighboursCountsAsZero) {
  const torch::Tensor target = torch::rand({1, 3, 16, 16}).expand({2, -1, -1, -1});
  const torch::Tensor warped = torch::zeros_like(target);
  const auto loss = [&](const torch::Tensor& present) {
    at::Generator random = generator();
    return photometric_loss(target, {warped}, {warped}, present, random).item<double>();
  };
  const double both = loss(torch::ones({2}));
  EXPECT_NEAR(loss(torch::tensor({1.0F, 0.0F})), both / 2, 1e-3 * both);
}

TEST(PhotometricLoss, GivesNoGradientWhereNothingMoved) {
  const torch::Tensor target = torch::rand({1, 3, 16, 16});
  torch::Tensor warped = torch::rand({1, 3, 16, 16}).requires_grad_();
  at::Generator random = generator();
  photometric_loss(target, {warped}, {target}, torch::ones({1}), random).backward();
  EXPECT_EQ(warped.grad().abs().sum().item<double>(), 0);
}

// Inverse depth 1, 3 of mean 2: difference 1 after the division; image difference d: exp(-d).
TEST(SmoothnessLoss, IsTheDivisionByTheMeanAndTheEdgeWeight) {
  const torch::Tensor inverse = torch::tensor({{1.0F, 3.0F}, {1.0F, 3.0F}}).reshape({1, 1, 2, 2});
  const torch::Tensor flat = torch::zeros({1, 3, 2, 2});
  EXPECT_NEAR(smoothness_loss(inverse, flat).item<double>(), 1, 1e-6);
  torch::Tensor edge = flat.clone();
  edge.narrow(3, 1, 1).fill_(0.5);
  EXPECT_NEAR(smoothness_loss(inverse, edge).item<double>(), std::exp(-0.5), 1e-6);
}

// Of mean 2, so .5 1 1.5 over .5 2 .5: differences .5 .5 1.5 1.5 to the right, 0 1 1 down. A second
// picture of ten times the inverse depth has a mean of its own.
TEST(SmoothnessLoss, LooksToTheRightAndDown) {
  const torch::Tensor one =
      torch::tensor({1.0F, 2.0F, 3.0F, 1.0F, 4.0F, 1.0F}).reshape({1, 1, 2, 3});
  const torch::Tensor inverse = torch::cat({one, 10 * one});
  const torch::Tensor flat = torch::zeros({2, 3, 2, 3});
  EXPECT_NEAR(smoothness_loss(inverse, flat).item<double>(), 1 + 2.0 / 3, 1e-6);
  // Colours that rise and fall do not make up for each other: means of .4 to the right, .2 down.
  const torch::Tensor right = torch::tensor({0.5F, -0.5F, 0.2F}).reshape({1, 3, 1, 1});
  const torch::Tensor down = torch::tensor({0.1F, -0.2F, 0.3F}).reshape({1, 3, 1, 1});
  const torch::Tensor columns = torch::arange(3).reshape({1, 1, 1, 3});
  const torch::Tensor rows = torch::arange(2).reshape({1, 1, 2, 1});
  const torch::Tensor image = (right * columns + down * rows).expand({2, 3, 2, 3});
  EXPECT_NEAR(smoothness_loss(inverse, image).item<double>(),
              std::exp(-0.4) + 2.0 / 3 * std::exp(-0.2), 1e-6);
}

TEST(PoseNet, HasTheSizeOfMonodepth2sAndStartsNearNoMotion) {
  torch::manual_seed(1);
  PoseNet net;
  std::int64_t numbers = 0;
  for (const torch::Tensor& each : net->parameters()) numbers += each.numel();
  // ResNet18 without classifier 11,176,512 with 3 channels; + 9,408 for three more; decoder
  // 131,328 + 2 x 590,080 + 3,084.
  EXPECT_EQ(numbers, 11'176'512 + 9'408 + 131'328 + 2 * 590'080 + 3'084);
  net->eval();
  const Motion motion = net->forward(torch::rand({2, 3, 64, 96}), torch::rand({2, 3, 64, 96}));
  EXPECT_EQ(motion.axis_angle.sizes(), (torch::IntArrayRef{2, 3}));
  EXPECT_LT(motion.translation.abs().max().item<double>(), 0.05);
}

// The first three channels are the picture taken earlier.
TEST(PoseNet, TakesTheEarlierPictureFirst) {
  torch::manual_seed(2);
  PoseNet net;
  net->eval();
  const torch::NoGradGuard no_grad;
  net->encoder->conv1->weight.narrow(1, 0, 3).zero_();
  const torch::Tensor a = torch::rand({1, 3, 64, 96});
  const torch::Tensor b = torch::rand({1, 3, 64, 96});
  const torch::Tensor motion = net->forward(a, b).axis_angle;
  EXPECT_TRUE(torch::equal(net->forward(torch::rand_like(a), b).axis_angle, motion));
  EXPECT_FALSE(torch::equal(net->forward(a, torch::rand_like(b)).axis_angle, motion));
}

constexpr int kWidth = 96;
constexpr int kHeight = 64;

// Smooth random colours, [1, 3, kHeight, kWidth].
torch::Tensor textured_wall() {
  namespace F = torch::nn::functional;
  return F::interpolate(torch::rand({1, 3, 12, 16}),
                        F::InterpolateFuncOptions()
                            .size(std::vector<std::int64_t>{kHeight, kWidth})
                            .mode(torch::kBicubic)
                            .align_corners(false));
}

// Depth alone is free: a textured wall at 4 m seen from .2 m apart. The loss must lead the guess
// from 6 m to the truth, which is the whole of self-supervision.
TEST(PhotometricLoss, LeadsDepthToTheTruth) {
  torch::manual_seed(4);
  const Pinholes cameras = pinholes_of({{kWidth, kHeight, 80, 80, 47.5F, 31.5F, true}});
  const torch::Tensor source = textured_wall();
  const torch::Tensor motion =
      rigid_motion(torch::zeros({1, 3}), torch::tensor({{-0.2F, 0.0F, 0.0F}}));
  const auto view = [&](const torch::Tensor& depth) {
    return sample_at(source, project(back_project(depth.expand({1, 1, kHeight, kWidth}), cameras),
                                     motion, cameras));
  };
  const torch::Tensor target = view(torch::full({1, 1, 1, 1}, 4.0F));
  torch::Tensor log_depth = torch::full({1, 1, 1, 1}, std::log(6.0F)).requires_grad_();
  torch::optim::Adam adam({log_depth}, torch::optim::AdamOptions(0.02));
  at::Generator random = generator();
  for (int i = 0; i < 100; ++i) {
    adam.zero_grad();
    photometric_loss(target, {view(log_depth.exp())}, {source}, torch::ones({1}), random)
        .backward();
    adam.step();
  }
  EXPECT_NEAR(log_depth.exp().item<double>(), 4, 0.1);
}

// The focal lengths alone are free: a camera of 80 and 84 px, thought to have 100 and 70, turns by
// a few degrees before a wall of known depth. A second camera is known and stays what it is.
TEST(LearnedCameras, AreLedToTheTruthByAKnownTurn) {
  torch::manual_seed(5);
  const Pinholes truth = pinholes_of({{kWidth, kHeight, 80, 84, 47.5F, 31.5F, true}});
  const Pinholes assumed = pinholes_of({{kWidth, kHeight, 100, 70, 47.5F, 31.5F, true}});
  const torch::Tensor source = textured_wall();
  const torch::Tensor depth = torch::full({1, 1, kHeight, kWidth}, 4.0F);
  const torch::Tensor motion =
      rigid_motion(torch::tensor({{0.04F, 0.06F, 0.0F}}), torch::tensor({{-0.2F, 0.1F, 0.0F}}));
  const auto view = [&](const Pinholes& cameras) {
    return sample_at(source, project(back_project(depth, cameras), motion, cameras));
  };
  const torch::Tensor target = view(truth);
  LearnedCameras learned(1);
  torch::optim::Adam adam(learned->parameters(), torch::optim::AdamOptions(0.01));
  at::Generator random = generator();
  const torch::Tensor mine = torch::zeros({1}, torch::kLong);
  for (int i = 0; i < 200; ++i) {
    adam.zero_grad();
    photometric_loss(target, {view(learned->forward(assumed, mine))}, {source}, torch::ones({1}),
                     random)
        .backward();
    adam.step();
  }
  const Pinholes found = learned->forward(assumed, mine);
  EXPECT_NEAR(found.fx.item<double>(), 80, 1.5);
  EXPECT_NEAR(found.fy.item<double>(), 84, 1.5);
  const Pinholes known = learned->forward(assumed, torch::full({1}, -1, torch::kLong));
  EXPECT_EQ(known.fx.item<float>(), 100);
}

}  // namespace
}  // namespace lcdm::model
