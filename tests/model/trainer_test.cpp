// The training loop: what it trains on and by, that it learns, and when it gives up.
#include "model/trainer.h"

#include <cmath>
#include <gtest/gtest.h>

#include "model/training_samples.h"
#include "tests/model/small_training.h"

namespace lcdm::model {
namespace {

// Every batch is of the shape that is asked for: what nothing is drawn for takes no part.
TEST(Trainer, TrainsOneShapeAlone) {
  for (float PackUse::*unasked : {&PackUse::wide_share, &PackUse::tall_share}) {
    std::vector<Pack> packs = {scene_packs()[0], scene_packs()[0]};
    packs[0].use.*unasked = 0;
    packs[1].use.wide_share = packs[1].use.tall_share = 0;
    packs[1].frames = std::make_shared<MemoryFrames>(
        std::vector<PackFrame>(packs[1].frames->size()), false);  // empty: not to be drawn
    const auto trainer = trainer_of(small_recipe(), packs);
    for (int i = 0; i < 2; ++i) ASSERT_TRUE(trainer->advance());
  }
}

// A side is a multiple of 32, so a share of 4:3 is seldom 4:3; what is cut for it is all the same.
TEST(TrainingSamples, AreCutInTheDevicesShapes) {
  for (const double share : {0.35, 0.5, 0.6, 1.0}) {
    for (const BatchShape& shape : make_shapes({}, {share, 4, 1}, 0, scene_packs())) {
      const double aspect = shape.squeeze * shape.width / shape.height;
      EXPECT_NEAR(aspect, shape.wide ? 640.0 / 192 : 4.0 / 3, 1e-9) << "share " << share;
    }
  }
}

TEST(Trainer, RefusesPacksThatAreNeverDrawn) {
  std::vector<Pack> packs = scene_packs();
  packs[0].use.wide_share = packs[0].use.tall_share = 0;
  EXPECT_EQ(Trainer::make(small_recipe(), packs, one_cpu()).code(), StatusCode::kInvalidInput);
  EXPECT_EQ(Trainer::make(small_recipe(), {}, one_cpu()).code(), StatusCode::kInvalidInput);
}

TEST(Trainer, RefusesThePhotometricLossWherePicturesHaveNoNeighbours) {
  Recipe recipe = small_recipe();
  recipe.workers = 1;
  recipe.losses.photometric = 1;
  const auto trainer = Trainer::make(recipe, scene_packs(), one_cpu());
  ASSERT_EQ(trainer.code(), StatusCode::kInvalidInput);
  EXPECT_NE(std::string(trainer.status().text()).find("--video"), std::string::npos);
}

// As empty depth pictures give: a training would end with a checkpoint of nothing.
TEST(Trainer, RefusesPicturesWithoutAnyDepthUnlessTheyTeachByThemselves) {
  std::vector<Pack> packs = {as_video(scene_packs()[0])};
  std::vector<PackFrame> frames;
  for (std::size_t i = 0; i < packs[0].frames->size(); ++i) {
    frames.push_back(*packs[0].frames->read(i));
    frames.back().depth = cv::Mat(cv::Mat::zeros(frames.back().depth.size(), CV_32F));
  }
  packs[0].frames = std::make_shared<MemoryFrames>(std::move(frames), true);
  Recipe recipe = small_recipe();
  const auto refused = Trainer::make(recipe, packs, one_cpu());
  ASSERT_EQ(refused.code(), StatusCode::kInvalidInput);
  EXPECT_NE(std::string(refused.status().text()).find("nothing to learn from"), std::string::npos);
  recipe.losses.photometric = 1;
  recipe.workers = 1;
  const auto taken = Trainer::make(recipe, packs, one_cpu());
  EXPECT_TRUE(taken) << taken.status().text();
}

TEST(Trainer, RefusesToLearnFocalLengthsWithoutThePhotometricLoss) {
  std::vector<Pack> packs = scene_packs();
  packs[0].use.learn_intrinsics = true;
  const auto trainer = Trainer::make(small_recipe(), packs, one_cpu());
  ASSERT_EQ(trainer.code(), StatusCode::kInvalidInput);
  EXPECT_NE(std::string(trainer.status().text()).find("--photometric"), std::string::npos);
}

TEST(Trainer, RefusesALicenceThatNoCheckpointCouldHold) {
  const auto trainer = trainer_of(small_recipe());
  EXPECT_TRUE(trainer->set_licence("MIT; HoloLens"));
  EXPECT_EQ(trainer->set_licence("two\nlines").code(), StatusCode::kInvalidInput);
}

// Everything of the paper at once on a moving camera: each term is there and the step is finite.
TEST(Trainer, TakesEveryLossOfThePaper) {
  Pack drive = as_video(scene_packs()[0]);
  drive.use.learn_intrinsics = true;
  const std::vector<Pack> packs = {drive};
  Recipe recipe = small_recipe();
  recipe.losses.normals = 1;
  recipe.losses.photometric = 1;
  recipe.losses.smoothness = 1e-3;
  EXPECT_EQ(Trainer::make(recipe, packs, one_cpu()).code(), StatusCode::kInvalidInput)
      << "a worker's part of one picture has no batch statistics";
  recipe.workers = 1;
  const auto trainer = trainer_of(recipe, packs);
  const Result<Losses> losses = trainer->advance();
  ASSERT_TRUE(losses) << losses.status().text();
  for (std::size_t i = 0; i < kTermNames.size(); ++i) {
    EXPECT_GT(losses->terms[i], 0) << kTermNames[i];
  }
  ASSERT_EQ(trainer->learned_focals().size(), 1U);
  EXPECT_NE(trainer->learned_focals()[0].fx, 1) << "the photometric loss moves the focal length";
}

// Two stages of two steps: pictures of each batch are counted, and the size follows.
TEST(Trainer, GoesThroughItsStagesAndAccumulates) {
  Recipe recipe = small_recipe();
  recipe.steps = 4;
  recipe.stages = {{0.2, 4, 0.5}, {0.3, 2, 1}};
  recipe.head_from = 1;
  recipe.accumulate = 2;
  const auto trainer = trainer_of(recipe);
  EXPECT_EQ(trainer->share(), 0.2);
  for (int i = 0; i < 4; ++i) ASSERT_TRUE(trainer->advance());
  EXPECT_EQ(trainer->share(), 0.3);
  EXPECT_EQ(trainer->images(), 2 * (4 + 8) + 2 * (2 + 4)) << "4:3: twice as many";
}

Batch joined(const Batch& a, const Batch& b) {
  const auto both = [](const torch::Tensor& x, const torch::Tensor& y) {
    return torch::cat({x, y});
  };
  Batch batch;
  batch.rgb = both(a.rgb, b.rgb);
  batch.cameras = {both(a.cameras.fx, b.cameras.fx), both(a.cameras.fy, b.cameras.fy),
                   both(a.cameras.cx, b.cameras.cx), both(a.cameras.cy, b.cameras.cy)};
  batch.target = {both(a.target.depth, b.target.depth), both(a.target.weight, b.target.weight),
                  both(a.target.sharp, b.target.sharp),
                  both(a.target.alignment, b.target.alignment)};
  return batch;
}

// Two batches of two pictures, a picture for each worker, against the four in one pass. The
// optimiser's first mean is a tenth of the gradient it was given.
TEST(Trainer, AccumulatesTheGradientOfOneLargeBatch) {
  std::vector<Pack> packs = scene_packs();
  packs[0].use.tall_share = 0;  // all of one shape, to be put together
  Recipe recipe = small_recipe();
  recipe.accumulate = 2;
  recipe.freeze_from = 0;  // nothing depends on what else is in a batch
  recipe.head_from = 1;    // nor on noise
  recipe.clip = 1e9;
  const auto trainer = trainer_of(recipe, packs);
  const BatchShape shape = make_shapes(recipe, recipe.stages[0], 0, packs).front();
  const Batch batch =
      joined(*make_batch(packs, shape, recipe.seed, 0), *make_batch(packs, shape, recipe.seed, 1));
  ASSERT_EQ(batch.rgb.size(0), 4);
  TrainedNetworks networks(trainer->config(), false);
  networks->depth = trainer->averaged();  // before the first step: what is trained
  at::Generator unused = at::detail::createCPUGenerator(1);
  const Losses whole = training_losses(networks, batch, recipe.losses, Part::kDirect, unused);
  whole.total.backward();
  double squares = 0;
  for (const torch::Tensor& parameter : networks->depth->parameters()) {
    if (parameter.grad().defined()) squares += parameter.grad().square().sum().item<double>();
  }
  const double all = std::sqrt(squares);
  ASSERT_GT(all, 0);

  const Result<Losses> losses = trainer->advance();
  ASSERT_TRUE(losses) << losses.status().text();
  const double total = whole.total.item<double>();
  EXPECT_NEAR(losses->total.item<double>(), total, 1e-4 * total);
  const auto state = state_of(*trainer);
  for (const auto& item : networks->depth->named_parameters()) {
    const torch::Tensor& wanted = item.value().grad();
    if (!wanted.defined()) continue;  // the head's
    const torch::Tensor got = state.at("adam.mean.depth." + item.key()) * 10;
    EXPECT_LT((got - wanted).norm().item<double>(),
              1e-2 * wanted.norm().item<double>() + 1e-4 * all)
        << item.key();
  }
}

// The optimiser's first means, too, are a tenth of what the recipe allows.
TEST(Trainer, ClipsTheGradientOfAStep) {
  Recipe recipe = small_recipe();
  recipe.clip = 1e-3;
  const auto trainer = trainer_of(recipe);
  ASSERT_TRUE(trainer->advance());
  double squares = 0;
  for (const auto& [name, tensor] : state_of(*trainer)) {
    if (name.starts_with("adam.mean.")) squares += tensor.square().sum().item<double>();
  }
  EXPECT_NEAR(std::sqrt(squares), 0.1 * recipe.clip, 1e-3 * recipe.clip);
}

// After its nth step it keeps (1 + n) / (10 + n) of the average, and the recipe's share at most:
// 2/11 first, then .22, as 3/12 would be more.
TEST(Trainer, AveragesWeightsAndStatisticsOverItsSteps) {
  Recipe recipe = small_recipe();
  recipe.average = 0.22;
  recipe.learning_rate = 1e-2;
  const auto trainer = trainer_of(recipe);
  auto before = state_of(*trainer);
  for (const double kept : {2.0 / 11, 0.22}) {
    ASSERT_TRUE(trainer->advance());
    const auto after = state_of(*trainer);
    for (const std::string name :
         {"direct.weight", "head.conv1.weight", "encoder.stem.bn.running_mean"}) {
      const torch::Tensor& old = before.at("average." + name);
      const torch::Tensor& trained = after.at("network.depth." + name);
      ASSERT_GT((trained - old).abs().max().item<double>(), 1e-4) << name;
      EXPECT_TRUE(
          torch::allclose(after.at("average." + name), kept * old + (1 - kept) * trained, 0, 1e-6))
          << name << ", keeping " << kept;
    }
    before = after;
  }
}

// bfloat16 in encoder and decoder: the loss stays close to float's, weights stay float.
TEST(Trainer, TrainsInMixedPrecision) {
  Recipe recipe = small_recipe();
  const Result<Losses> exact = trainer_of(recipe)->advance();
  recipe.bf16 = true;
  const auto mixed = trainer_of(recipe);
  const Result<Losses> losses = mixed->advance();
  ASSERT_TRUE(losses) << losses.status().text();
  const double expected = (*exact)[Term::kDistillation];
  EXPECT_NE((*losses)[Term::kDistillation], expected);
  EXPECT_NEAR((*losses)[Term::kDistillation], expected, 0.05 * expected);
  EXPECT_EQ(mixed->averaged()->direct->weight.scalar_type(), torch::kFloat32);
}

// Every worker computes as the recipe says, and statistics are measured in float all the same.
TEST(Trainer, TrainsAllWorkersInMixedPrecision) {
  const auto exact = trainer_of(small_recipe());
  TrainedNetworks networks(exact->config(), false, 0);
  networks->depth->mixed_precision = true;
  Replicas replicas(networks, 2);
  EXPECT_TRUE(replicas.of(1)->depth->mixed_precision);
  Recipe recipe = small_recipe();
  recipe.bf16 = true;
  const auto mixed = trainer_of(recipe);
  const Status started = mixed->start_from(exact->averaged(), NormStatistics::kMissing);
  ASSERT_TRUE(started) << started.text();
  EXPECT_TRUE(mixed->advance());
}

TEST(Trainer, SaysWhyItStopsOnNan) {
  Recipe recipe = small_recipe();
  recipe.learning_rate = 1e30;
  recipe.warm_up = 1;
  const auto trainer = trainer_of(recipe);
  Status last;
  for (int i = 0; i < 6 && last; ++i) {
    const Result<Losses> losses = trainer->advance();
    if (!losses) last = losses.status();
  }
  ASSERT_FALSE(last);
  EXPECT_NE(std::string(last.text()).find("not finite"), std::string::npos) << last.text();
}

// 200 steps of loss 1, then 10 each: the mean of 200 passes 5 once 89 of them are 10.
TEST(Divergence, IsAMeanFarAboveItsBest) {
  Divergence divergence;
  for (int i = 0; i < 200; ++i) divergence.add(1, {});
  for (int i = 0; i < 88; ++i) divergence.add(10, {});
  EXPECT_FALSE(divergence.found());
  Divergence resumed;
  resumed.restore(divergence.numbers());
  resumed.add(10, {});
  EXPECT_TRUE(resumed.found());
  EXPECT_NE(resumed.text().find("it was 1"), std::string::npos) << resumed.text();
  resumed.add(10, {0, true});
  EXPECT_FALSE(resumed.found()) << "with the head a loss is another sum";
}

// Its gradient is clipped: the training goes on.
TEST(Divergence, IsNotOneWildBatch) {
  Divergence divergence;
  for (int i = 0; i < 200; ++i) divergence.add(1, {});
  divergence.add(1e9, {});
  EXPECT_FALSE(divergence.found());
  for (int i = 0; i < 8; ++i) divergence.add(1e9, {});
  EXPECT_TRUE(divergence.found()) << "nine are";
}

// A checkpoint that holds a training about to diverge stops where the unbroken one would.
TEST(Trainer, SaysWhyItStopsWhereLossesStayFarAboveTheirBest) {
  const test::TemporaryFolder folder;
  const std::string path = folder.file("checkpoint.safetensors");
  ASSERT_TRUE(trainer_of(small_recipe())->save(path));
  TensorFile file = *read_tensors(path);
  Divergence past;
  for (std::size_t i = 0; i < Divergence::kWindow; ++i) past.add(1e-6, {0, true});
  for (int i = 0; i < 8; ++i) past.add(1, {0, true});
  file.tensors["trainer.divergence"] = past.numbers();
  ASSERT_TRUE(write_tensors(path, file));
  const auto trainer = trainer_of(small_recipe());
  ASSERT_TRUE(trainer->resume(path));
  const Result<Losses> losses = trainer->advance();
  ASSERT_EQ(losses.code(), StatusCode::kCorrupt);
  EXPECT_NE(std::string(losses.status().text()).find("diverges"), std::string::npos);
}

// Half a minute of training on a few rendered frames halves the loss, and what is kept shows it.
TEST(Trainer, FitsAFewFrames) {
  at::set_num_threads(2);
  Recipe recipe = small_recipe();
  recipe.steps = 160;
  recipe.stages = {{0.25, 4, 1}};
  recipe.warm_up = 10;
  recipe.average = 0.9;
  recipe.freeze_from = 0.5;
  const auto trainer = trainer_of(recipe);
  double first = 0;
  double last = 0;
  for (int i = 0; i < recipe.steps; ++i) {
    const Result<Losses> losses = trainer->advance();
    ASSERT_TRUE(losses) << losses.status().text();
    if (i < 10) first += (*losses)[Term::kDistillation] / 10;
    if (i >= recipe.steps - 10) last += (*losses)[Term::kDistillation] / 10;
  }
  EXPECT_LT(last, 0.5 * first);
  // What is kept, the averaged weights in evaluation mode, at the size it was trained at.
  const BatchShape shape{160, 64, 80, 8, true};
  const Batch batch = *make_batch(scene_packs(), shape, 77, 0);
  at::Generator generator = at::detail::createCPUGenerator(1);
  const torch::NoGradGuard no_grad;
  TrainedNetworks networks(trainer->config(), false);
  networks->depth = trainer->averaged();
  const Losses kept = training_losses(networks, batch, recipe.losses, Part::kWhole, generator);
  EXPECT_LT(kept[Term::kDistillation], 0.6 * first);
}

}  // namespace
}  // namespace lcdm::model
