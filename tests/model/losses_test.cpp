// Losses against values worked out by hand.
#include "model/losses.h"

#include <cmath>
#include <gtest/gtest.h>

#include "firmware/nn/sampler.h"
#include "model/depth_code.h"

namespace lcdm::model {
namespace {

torch::Tensor image(std::vector<float> values, std::int64_t height, std::int64_t width) {
  return torch::tensor(values).reshape({1, 1, height, width});
}

torch::Tensor no_mask(const torch::Tensor& like) { return torch::ones_like(like, torch::kBool); }

ModelConfig small_config() {
  ModelConfig config;
  config.encoder = EncoderKind::kXxs;
  return config;
}

TEST(MaskedMean, CountsOnlyWhatIsValid) {
  const torch::Tensor error = image({1, 100, 3, NAN}, 2, 2);
  const torch::Tensor mask = image({1, 0, 1, 0}, 2, 2).to(torch::kBool);
  EXPECT_DOUBLE_EQ(masked_mean(error, mask, torch::ones({1})).item<float>(), 2);
}

// Whatever else is in the batch: with one picture for each worker there is nothing else.
TEST(MaskedMean, HalfTheTrustIsHalfTheLoss) {
  const torch::Tensor error = image({4, 4}, 1, 2);
  EXPECT_FLOAT_EQ(masked_mean(error, no_mask(error), torch::tensor({0.5F})).item<float>(), 2);
}

TEST(MaskedMean, EveryImageCountsByItsWeightHoweverManyPixelsItHas) {
  const torch::Tensor error = torch::cat({image({1, 1, 1, 1}, 2, 2), image({5, 9, 9, 9}, 2, 2)});
  const torch::Tensor mask =
      torch::cat({image({1, 1, 1, 1}, 2, 2), image({1, 0, 0, 0}, 2, 2)}).to(torch::kBool);
  EXPECT_FLOAT_EQ(masked_mean(error, mask, torch::tensor({1.0F, 3.0F})).item<float>(),
                  8);  // (1 + 3 * 5) / 2
}

// What a picture teaches must not depend on which others share its worker.
TEST(MaskedMean, AnImageWithoutDepthCountsAsZero) {
  const torch::Tensor error = torch::cat({image({2, 2}, 1, 2), image({7, 7}, 1, 2)});
  const torch::Tensor mask =
      torch::cat({image({1, 1}, 1, 2), image({0, 0}, 1, 2)}).to(torch::kBool);
  EXPECT_FLOAT_EQ(masked_mean(error, mask, torch::ones({2})).item<float>(), 1);
}

// Errors log 2 and -log 4: mean -log(2) / 2, each 1.5 log 2 away from it.
TEST(LogDepthLoss, IsTheMeanAbsoluteLogErrorOfTheShapePlusAShareOfTheScale) {
  const torch::Tensor estimate = image({2, 8}, 1, 2).log();
  const torch::Tensor truth = image({1, 32}, 1, 2).log();
  EXPECT_NEAR(log_depth_loss(estimate, truth, no_mask(truth), torch::ones({1})).item<float>(),
              (1.5 + kScaleWeight * 0.5) * std::log(2.0), 1e-6);
}

TEST(LogDepthLoss, LeavesHolesOutOfShapeAndScale) {
  const torch::Tensor estimate = image({2, 2, 90}, 1, 3).log();
  const torch::Tensor truth = image({1, 1, 1}, 1, 3).log();
  const torch::Tensor mask = image({1, 1, 0}, 1, 3).to(torch::kBool);
  EXPECT_NEAR(log_depth_loss(estimate, truth, mask, torch::ones({1})).item<float>(),
              kScaleWeight * std::log(2.0), 1e-6);
}

TEST(GradientLoss, IsZeroForAConstantFactor) {
  const torch::Tensor truth = torch::rand({1, 1, 16, 16});
  EXPECT_NEAR(gradient_loss(truth + 0.7, truth, no_mask(truth), torch::ones({1})).item<float>(), 0,
              1e-6);
}

TEST(GradientLoss, OfARampGrowsWithTheScale) {
  // Error 0.1 x: x differences 0.1, 0.2, 0.4, 0.8 at the four scales, y differences 0.
  const torch::Tensor truth = torch::zeros({1, 1, 32, 32});
  const torch::Tensor estimate =
      (torch::arange(32) * 0.1).to(torch::kFloat32).reshape({1, 1, 1, 32}).expand({1, 1, 32, 32});
  EXPECT_NEAR(gradient_loss(estimate, truth, no_mask(truth), torch::ones({1})).item<float>(),
              (0.1 + 0.2 + 0.4 + 0.8) / 4, 1e-5);
}

torch::Tensor kinds_of(std::initializer_list<Alignment> kinds) {
  std::vector<std::int64_t> numbers;
  for (const Alignment kind : kinds) numbers.push_back(static_cast<std::int64_t>(kind));
  return torch::tensor(numbers, torch::kLong);
}

// Whose variable's mean and two deviations reach from .14 to 53 canonical metres.
ModelConfig wide() {
  ModelConfig config;
  config.variable_mean = -3;
  config.variable_std = 2;
  return config;
}

TEST(AlignToStudent, MovesByTheMedianWhatHasNoScale) {
  const torch::Tensor target = torch::zeros({2, 1, 1, 3});
  const torch::Tensor student = torch::cat({image({1, 2, 9}, 1, 3), image({1, 2, 9}, 1, 3)});
  const torch::Tensor kinds = kinds_of({Alignment::kNone, Alignment::kScale});
  const torch::Tensor out = align_to_student(target, student, no_mask(target), kinds, wide());
  EXPECT_EQ(out[0].abs().max().item<float>(), 0);
  EXPECT_EQ((out[1] - 2).abs().max().item<float>(), 0);
}

// A teacher whose inverse depth is 3 times the student's less 0.5 becomes the student.
TEST(AlignToStudent, FitsScaleAndShiftOfInverseDepth) {
  const torch::Tensor inverse = image({0.9F, 0.5F, 0.3F, 0.25F}, 1, 4);
  const torch::Tensor teacher = 3 * inverse - 0.5;
  const torch::Tensor out = align_to_student(-teacher.log(), -inverse.log(), no_mask(inverse),
                                             kinds_of({Alignment::kAffine}), wide());
  EXPECT_LT((out + inverse.log()).abs().max().item<float>(), 1e-5);
}

// The fit of 99 pixels that a single outlier, the farthest, does not follow.
TEST(AlignToStudent, FitsThoughAFewPixelsLandBeyondTheFarthest) {
  const torch::Tensor inverse = torch::linspace(0.05, 1, 100).reshape({1, 1, 10, 10});
  torch::Tensor teacher = 2 * inverse + 0.3;
  teacher.view(-1)[0] = 0.1;  // 0.2 too little: a - 0.1 once scaled back
  const torch::Tensor out = align_to_student(-teacher.log(), -inverse.log(), no_mask(inverse),
                                             kinds_of({Alignment::kAffine}), wide());
  EXPECT_LT((out + inverse.log()).abs().narrow(2, 5, 5).max().item<float>(), 0.05);
  EXPECT_NEAR(out.view(-1)[0].item<float>(), std::log(100.0F), 1e-4);
}

// Where near and far are swapped no scale and shift make depth of it: the median is all that helps.
TEST(AlignToStudent, FallsBackToTheMedianWhereTheFitIsNoDepth) {
  const torch::Tensor student = image({1, 2, 3}, 1, 3);
  const torch::Tensor target = image({3, 2, 1}, 1, 3);
  const torch::Tensor out =
      align_to_student(target, student, no_mask(target), kinds_of({Alignment::kAffine}), wide());
  EXPECT_EQ((out - target).abs().max().item<float>(), 0);  // the median error is 0 already
}

// A student who says the same everywhere must not make its teacher do so too, or it would have
// nothing left to learn.
TEST(AlignToStudent, AFlatStudentDoesNotFlattenATeacherOfUnknownShift) {
  const torch::Tensor student = torch::full({1, 1, 1, 4}, std::log(2.0F));
  const torch::Tensor teacher = image({0.9F, 0.5F, 0.3F, 0.25F}, 1, 4);
  const torch::Tensor out = align_to_student(-teacher.log(), student, no_mask(student),
                                             kinds_of({Alignment::kAffine}), wide());
  const torch::Tensor inverse = torch::exp(-out);
  EXPECT_NEAR(inverse.mean().item<float>(), 0.5, 1e-5);
  EXPECT_NEAR((inverse - 0.5).square().mean().sqrt().item<float>(), 0.25 * 0.5, 1e-5);
}

// Nothing else holds the scale of a training whose every target follows the student.
TEST(AlignToStudent, KeepsTheMedianInReach) {
  const torch::Tensor target = image({1, 2, 3}, 1, 3);
  for (const Alignment kind : {Alignment::kScale, Alignment::kAffine}) {
    for (const auto& [drifted, end] : {std::pair{-9.0, 2.0F}, std::pair{4.5, -2.0F}}) {
      const torch::Tensor out = align_to_student(target, target * 0.01 + drifted, no_mask(target),
                                                 kinds_of({kind}), wide());
      const torch::Tensor held = log_depth_of_variable(torch::full({1}, end), wide());
      EXPECT_NEAR(out.median().item<float>(), held.item<float>(), 1e-4);
    }
  }
}

// A picture without a teacher's depth, among others in its batch: no median, no line, no NaN.
TEST(AlignToStudent, LeavesAPictureOfWhichNothingIsKnown) {
  const torch::Tensor target = torch::zeros({2, 1, 1, 3});
  const torch::Tensor student = torch::ones({2, 1, 1, 3});
  const torch::Tensor nothing = torch::zeros({2, 1, 1, 3}, torch::kBool);
  const torch::Tensor out = align_to_student(
      target, student, nothing, kinds_of({Alignment::kScale, Alignment::kAffine}), wide());
  EXPECT_TRUE(torch::equal(out, target));
}

TEST(DepthCode, RoundTrips) {
  ModelConfig config;
  config.variable_mean = -4;
  config.variable_std = 1.5;
  const torch::Tensor depth = image({0.2F, 1, 7, 60}, 1, 4);
  const torch::Tensor back = depth_of_variable(variable_of_depth(depth, config), config);
  EXPECT_LT(((back - depth) / depth).abs().max().item<float>(), 1e-3);
}

TEST(DepthCode, FollowsTheFormulaOfTheSpecification) {
  const ModelConfig config;  // mean 0, deviation 1
  // d = (1 / 2 - 0.01) / 9.99; logit(d) = log(d / (1 - d)).
  const double d = (0.5 - 0.01) / 9.99;
  EXPECT_NEAR(variable_of_depth(image({2}, 1, 1), config).item<float>(), std::log(d / (1 - d)),
              1e-5);
  EXPECT_NEAR(depth_of_variable(image({0}, 1, 1), config).item<float>(), 1 / (0.01 + 9.99 / 2),
              1e-5);
}

TEST(DenoisingLoss, IgnoresWhatTheTargetHoldsInHoles) {
  torch::manual_seed(3);
  DepthNetwork network(small_config());
  network->eval();
  at::Generator generator = at::detail::createCPUGenerator(5);
  const torch::Tensor condition = torch::randn({1, 16, 32, 32});
  const torch::Tensor target = torch::randn({1, 1, 32, 32});
  const torch::Tensor student = torch::randn({1, 1, 32, 32});
  const torch::Tensor mask = torch::rand({1, 1, 32, 32}) > 0.9;
  const DenoisingDraw draw = draw_denoising(network, generator, target.sizes());
  const torch::Tensor poisoned = torch::where(mask, target, torch::full_like(target, NAN));
  const auto loss = [&](const torch::Tensor& t) {
    return denoising_loss(network, condition, t, student, mask, torch::ones({1}), draw)
        .item<float>();
  };
  EXPECT_EQ(loss(target), loss(poisoned));
}

// v = sqrt(a) eps - sqrt(1 - a) x0: a network that answers 0 has the loss E[v^2] = 1 for x0 and eps
// of unit variance, at every t.
TEST(DenoisingLoss, OfAMuteNetworkIsTheVarianceOfV) {
  torch::manual_seed(4);
  DepthNetwork network(small_config());
  network->eval();
  const torch::NoGradGuard no_grad;
  network->head->conv2->weight.zero_();
  network->head->conv2->bias.zero_();
  const torch::Tensor x0 = torch::randn({8, 1, 64, 64});
  const DenoisingDraw draw{torch::tensor({0, 20, 40, 60, 80, 100, 120, 149}, torch::kLong),
                           torch::randn({8, 1, 64, 64}), 0};
  const float loss = denoising_loss(network, torch::zeros({8, 16, 64, 64}), x0, x0, no_mask(x0),
                                    torch::ones({8}), draw)
                         .item<float>();
  EXPECT_NEAR(loss, 1, 0.03);
}

// A head that answers one number, at x0 = 1 and noise 2: it is right where that is v for `lcdm`,
// and the noise for `paper`.
TEST(DenoisingLoss, IsZeroForTheRightAnswer) {
  for (const PresetKind preset : {PresetKind::kLcdm, PresetKind::kPaper}) {
    ModelConfig config = small_config();
    config.preset = preset;
    DepthNetwork network(config);
    network->eval();
    const torch::NoGradGuard no_grad;
    const double a = cumulative_alphas(preset)[74];
    const double v = 2 * std::sqrt(a) - std::sqrt(1 - a);
    network->head->conv2->weight.zero_();
    network->head->conv2->bias.fill_(preset == PresetKind::kLcdm ? v : 2);
    const torch::Tensor x0 = torch::ones({1, 1, 8, 8});
    const DenoisingDraw draw{torch::full({1}, 74, torch::kLong), 2 * x0, 1};
    const torch::Tensor condition = torch::zeros({1, config.condition_channels, 8, 8});
    EXPECT_NEAR(denoising_loss(network, condition, x0, x0, no_mask(x0), torch::ones({1}), draw)
                    .item<float>(),
                0, 1e-6)
        << "preset " << static_cast<int>(preset);
  }
}

TEST(DrawDenoising, StaysWithinOneSamplerStep) {
  DepthNetwork network(small_config());
  at::Generator generator = at::detail::createCPUGenerator(6);
  bool seen[2] = {};
  for (int i = 0; i < 20; ++i) {
    const DenoisingDraw draw = draw_denoising(network, generator, {4, 1, 2, 2});
    seen[draw.step] = true;
    for (std::int64_t b = 0; b < 4; ++b) {
      EXPECT_EQ(network->step_of(draw.times[b].item<int>()), draw.step);
    }
  }
  EXPECT_TRUE(seen[0] && seen[1]);
}

TEST(NormalLoss, IsTheSquaredDistanceOfTheUnitNormals) {
  const Pinholes cameras = pinholes_of({{64, 64, 60, 60, 31.5F, 31.5F, true}});
  const Rays rays = rays_of(cameras, 64, 64);
  const torch::Tensor facing = torch::full({1, 1, 64, 64}, 4.0F);
  const torch::Tensor slanted = 4 / (1 + 0.75 * rays.x);  // normal (.6, 0, .8)
  const torch::Tensor mask = torch::ones({1, 1, 64, 64}, torch::kBool);
  const double loss =
      normal_loss(facing, slanted, mask, torch::ones({1}), cameras, PresetKind::kLcdm)
          .item<double>();
  EXPECT_NEAR(loss, 0.6 * 0.6 + 0.2 * 0.2, 1e-3);
  EXPECT_NEAR(normal_loss(2 * facing, facing, mask, torch::ones({1}), cameras, PresetKind::kPaper)
                  .item<double>(),
              0, 1e-6)
      << "scale is not a normal's business";
}

// Two random pictures of 64x64 with their neighbours, everything 5 m away.
Batch random_batch() {
  const torch::Tensor picture = torch::rand({2, 3, 64, 64});
  Batch batch;
  batch.rgb = (picture - 0.45) / 0.225;
  const CameraModel camera{64, 64, 60, 60, 31.5F, 31.5F, true};
  batch.cameras = pinholes_of({camera, camera});
  batch.target = {torch::full({2, 1, 64, 64}, 5.0F), torch::ones({2}), torch::ones({2}),
                  torch::zeros({2}, torch::kLong)};
  batch.views = {picture, torch::rand_like(picture), torch::rand_like(picture), torch::ones({2})};
  return batch;
}

// Maps of a teacher whose metres are a hundredth of ours lie below the nearest that can be said,
// and are as good as any once they are aligned.
TEST(TrainingLosses, KeepTheNearFieldOfTeachersOfTinyScale) {
  torch::manual_seed(9);
  TrainedNetworks networks(small_config(), false);
  networks->eval();
  Batch batch = random_batch();
  batch.target.depth = 0.5 + 4 * torch::rand({2, 1, 64, 64});
  batch.target.alignment = kinds_of({Alignment::kScale, Alignment::kScale});
  const auto distillation = [&](double scale) {
    Batch scaled = batch;
    scaled.target.depth = batch.target.depth * scale;
    at::Generator generator = at::detail::createCPUGenerator(8);
    return training_losses(networks, scaled, {}, Part::kDirect, generator)[Term::kDistillation];
  };
  EXPECT_NEAR(distillation(0.01), distillation(1), 1e-4);
}

// The paper's own: plain L1 on metres, of whatever has a depth.
TEST(TrainingLosses, OfThePaperCompareMetres) {
  ModelConfig config = small_config();
  config.preset = PresetKind::kPaper;
  TrainedNetworks networks(config, false);
  networks->eval();
  const torch::NoGradGuard no_grad;
  networks->depth->direct->weight.zero_();
  networks->depth->direct->bias.zero_();
  const float said = depth_of_variable(torch::zeros({1}), config).item<float>();
  Batch batch = random_batch();
  batch.target.depth = torch::zeros({2, 1, 64, 64});
  batch.target.depth[0].narrow(1, 0, 32).fill_(said + 2);
  batch.target.depth[1].narrow(1, 0, 32).fill_(said + 0.5F);
  at::Generator generator = at::detail::createCPUGenerator(8);
  const Losses losses = training_losses(networks, batch, {}, Part::kDirect, generator);
  EXPECT_NEAR(losses[Term::kDistillation], (2 + 0.5) / 2, 1e-4);
}

// Equation 11 and our two additions.
TEST(TrainingLosses, AreTheWeightedSumOfTheirTerms) {
  torch::manual_seed(10);
  TrainedNetworks networks(small_config(), true);
  networks->eval();
  at::Generator generator = at::detail::createCPUGenerator(8);
  const LossWeights weights{2, 3, 0.5, 0.7, 0.01, 0.4, 0.6};
  const Losses losses = training_losses(networks, random_batch(), weights, Part::kWhole, generator);
  const double sum = 2 * losses[Term::kDistillation] + 3 * losses[Term::kDenoising] +
                     0.5 * losses[Term::kNormals] + 0.7 * losses[Term::kPhotometric] +
                     0.01 * losses[Term::kSmoothness] + 0.4 * losses[Term::kGradient] +
                     0.6 * losses[Term::kDirect];
  EXPECT_NEAR(losses.total.item<double>(), sum, 1e-4 * sum);
}

// Each sampler step has a norm of its own: neither is out of the rollout's reach.
TEST(TrainingLosses, ReachTheHeadThroughBothStepsOfTheRollout) {
  torch::manual_seed(11);
  TrainedNetworks networks(small_config(), false);
  networks->eval();
  at::Generator generator = at::detail::createCPUGenerator(8);
  LossWeights weights;
  weights.denoising = weights.direct = 0;
  training_losses(networks, random_batch(), weights, Part::kWhole, generator).total.backward();
  for (const Norm& norm : networks->depth->head->norm) {
    EXPECT_GT(norm->weight.grad().abs().sum().item<float>(), 0);
  }
}

// Between frames everything moves four pixels to the right, by a pose network that always answers
// so and a depth that is the same everywhere. The frame before is seen by the motion undone: wrong
// way round, both neighbours are eight pixels off.
TEST(TrainingLosses, SeeTheFrameBeforeByTheMotionUndone) {
  torch::manual_seed(12);
  TrainedNetworks networks(small_config(), true);
  networks->eval();
  const torch::NoGradGuard no_grad;
  constexpr int kShift = 4;
  Batch batch = random_batch();
  const torch::Tensor wide = torch::avg_pool2d(torch::rand({2, 3, 68, 84}), 5, 1);
  batch.views.here = wide.narrow(3, 8, 64);
  batch.views.earlier = wide.narrow(3, 8 + kShift, 64);
  batch.views.later = wide.narrow(3, 8 - kShift, 64);
  networks->depth->direct->weight.zero_();
  networks->depth->direct->bias.zero_();
  const double depth = depth_of_variable(torch::zeros({1}), small_config()).item<double>();
  networks->pose->pose_2->weight.zero_();
  networks->pose->pose_2->bias.zero_();
  networks->pose->pose_2->bias[3] = 100 * kShift * depth / 60;  // PoseNet's unit is .01
  LossWeights weights;
  weights.photometric = 1;
  const auto photometric = [&] {
    at::Generator generator = at::detail::createCPUGenerator(8);
    return training_losses(networks, batch, weights, Part::kDirect, generator)[Term::kPhotometric];
  };
  const double right = photometric();
  std::swap(batch.views.earlier, batch.views.later);
  EXPECT_LT(right, 0.1 * photometric());
}

TEST(TrainingLosses, NinetyPercentHolesGiveNoNanAndNoBias) {
  torch::manual_seed(7);
  TrainedNetworks networks(small_config(), true);
  networks->eval();
  at::Generator generator = at::detail::createCPUGenerator(8);
  const Batch full = random_batch();
  Batch holes = full;
  holes.target.depth = torch::where(torch::rand({2, 1, 64, 64}) < 0.9, torch::zeros({2, 1, 64, 64}),
                                    full.target.depth);
  LossWeights weights;
  weights.normals = 1;
  weights.photometric = 1;
  weights.smoothness = 1e-3;
  const Losses a = training_losses(networks, full, weights, Part::kWhole, generator);
  const Losses b = training_losses(networks, holes, weights, Part::kWhole, generator);
  b.total.backward();
  for (const auto& parameter : networks->named_parameters()) {
    const torch::Tensor& grad = parameter.value().grad();
    if (!grad.defined()) continue;
    EXPECT_TRUE(torch::isfinite(grad).all().item<bool>()) << parameter.key();
  }
  EXPECT_NEAR(b[Term::kDistillation], a[Term::kDistillation], 0.05 * a[Term::kDistillation]);
  for (const Term term : {Term::kNormals, Term::kPhotometric, Term::kSmoothness}) {
    EXPECT_GT(a[term], 0) << kTermNames[static_cast<std::size_t>(term)];
  }
}

}  // namespace
}  // namespace lcdm::model
