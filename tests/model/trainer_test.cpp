// The training loop: it learns, stops and goes on, and never loses a checkpoint.
#include "model/trainer.h"

#include <gtest/gtest.h>

#include "model/checkpoint.h"
#include "model/replicas.h"
#include "model/safetensors.h"
#include "model/scene_pack.h"
#include "model/training_samples.h"
#include "tests/support/temporary_folder.h"

namespace lcdm::model {
namespace {

const std::vector<Pack>& scene_packs() {
  static const std::vector<Pack> packs = [] {
    ScenePackOptions options;
    options.train_frames = 24;
    options.validation_frames = 8;
    return std::vector<Pack>{rendered_pack(options)};
  }();
  return packs;
}

Recipe small_recipe() {
  Recipe recipe;
  recipe.encoder = EncoderKind::kXxs;
  recipe.steps = 6;
  recipe.stages = {{0.25, 2, 1}};
  recipe.head_from = 0;
  recipe.warm_up = 2;
  return recipe;
}

bool same_weights(Trainer& a, Trainer& b) {
  std::map<std::string, torch::Tensor> left;
  std::map<std::string, torch::Tensor> right;
  collect(*a.averaged(), "", left);
  collect(*b.averaged(), "", right);
  for (const auto& [name, tensor] : left) {
    if (!torch::equal(tensor, right[name])) return false;
  }
  return true;
}

// All that a training is made of: weights, optimiser, counters.
std::map<std::string, torch::Tensor> state_of(const Trainer& trainer) {
  const test::TemporaryFolder folder;
  const std::string path = folder.file("checkpoint.safetensors");
  EXPECT_TRUE(trainer.save(path));
  const Result<TensorFile> file = read_tensors(path);
  EXPECT_TRUE(file) << file.status().text();
  return file->tensors;
}

std::unique_ptr<Trainer> trainer_of(const Recipe& recipe,
                                    const std::vector<Pack>& packs = scene_packs()) {
  auto trainer = Trainer::make(recipe, packs, one_cpu());
  EXPECT_TRUE(trainer) << trainer.status().text();
  return std::move(*trainer);
}

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

TEST(Trainer, RefusesALicenceThatNoCheckpointCouldHold) {
  const auto trainer = trainer_of(small_recipe());
  EXPECT_TRUE(trainer->set_licence("MIT; HoloLens"));
  EXPECT_EQ(trainer->set_licence("two\nlines").code(), StatusCode::kInvalidInput);
}

// A run stopped after three of six steps, over the step where the head joins.
void expect_exact_resume(double freeze_from, OptimizerKind optimizer) {
  at::set_num_threads(1);
  const test::TemporaryFolder folder;
  const std::string path = folder.file("checkpoint.safetensors");
  Recipe recipe = small_recipe();
  recipe.head_from = 0.6;
  recipe.freeze_from = freeze_from;
  recipe.optimizer = optimizer;
  const auto straight = trainer_of(recipe);
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(straight->advance());
  EXPECT_TRUE(straight->update_best(0.5));
  ASSERT_TRUE(straight->save(path));
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(straight->advance());

  const auto resumed = trainer_of(recipe);
  const Status status = resumed->resume(path);
  ASSERT_TRUE(status) << status.text();
  EXPECT_EQ(resumed->step(), 3);
  EXPECT_FALSE(resumed->update_best(0.6)) << "the best score is part of the checkpoint";
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(resumed->advance());
  EXPECT_TRUE(resumed->done());
  const auto wanted = state_of(*straight);
  const auto got = state_of(*resumed);
  ASSERT_EQ(got.size(), wanted.size());
  for (const auto& [name, tensor] : wanted) EXPECT_TRUE(torch::equal(tensor, got.at(name))) << name;
}

TEST(Trainer, ResumesBitExactlyWhileStatisticsMove) {
  expect_exact_resume(1, OptimizerKind::kAdamW);
}
TEST(Trainer, ResumesBitExactlyWhenTheyAreFrozen) {
  expect_exact_resume(0.2, OptimizerKind::kAdamW);
}
TEST(Trainer, ResumesBitExactlyWithMuon) { expect_exact_resume(1, OptimizerKind::kMuon); }

// A checkpoint of an older program names the sizes of then.
TEST(Trainer, ResumesWithTheSizesItTrainsAtFromNowOn) {
  const test::TemporaryFolder folder;
  const std::string path = folder.file("checkpoint.safetensors");
  const auto trainer = trainer_of(small_recipe());
  const auto sizes = trainer->config().trained_sizes;
  ASSERT_TRUE(trainer->save(path));
  Result<TensorFile> file = read_tensors(path);
  ASSERT_TRUE(file) << file.status().text();
  std::string& text = file->metadata["lcdm"];
  const std::string today = "[256, 192]";
  ASSERT_NE(text.find(today), std::string::npos) << text;
  text.replace(text.find(today), today.size(), "[384, 288]");
  ASSERT_TRUE(write_tensors(path, *file));
  ASSERT_TRUE(trainer->resume(path));
  EXPECT_EQ(trainer->config().trained_sizes, sizes);
}

// Frozen at mean 0 and deviation 1 they would normalise nothing for the rest of the run.
TEST(Trainer, MeasuresAHeadThatJoinsAfterStatisticsAreFrozen) {
  Recipe recipe = small_recipe();
  recipe.steps = 2;
  recipe.freeze_from = 0;
  recipe.head_from = 0.5;
  const auto trainer = trainer_of(recipe);
  const auto moved = [&](std::size_t step) {
    const Norm& norm = trainer->averaged()->head->norm[step];
    return (norm->running_mean != 0).all().item<bool>() &&
           (norm->running_var != 1).all().item<bool>();
  };
  ASSERT_TRUE(trainer->advance());
  EXPECT_FALSE(moved(0)) << "the head has not joined";
  ASSERT_TRUE(trainer->advance());
  EXPECT_TRUE(moved(0) && moved(1));
}

// So do those of a few pictures: a tenth of the way is made in each step.
TEST(Trainer, MeasuresAHeadThatJoinsShortlyBeforeStatisticsAreFrozen) {
  Recipe recipe = small_recipe();
  recipe.steps = 3;
  recipe.head_from = 0;
  recipe.freeze_from = 0.5;  // from the third step on
  const auto trainer = trainer_of(recipe);
  const auto spread = [&] {
    return trainer->averaged()->head->norm[0]->running_var.log().abs().max().item<float>();
  };
  for (int i = 0; i < 2; ++i) ASSERT_TRUE(trainer->advance());
  const float of_two_steps = spread();
  ASSERT_TRUE(trainer->advance());
  EXPECT_GT(spread(), 3 * of_two_steps);
}

// The stage in which the head joins is the first of one recipe and the second of the other.
TEST(Trainer, MeasuresANewHeadAtThePresentSize) {
  const test::TemporaryFolder folder;
  const std::string path = folder.file("checkpoint.safetensors");
  at::set_num_threads(1);
  Recipe recipe = small_recipe();
  recipe.steps = 2;
  recipe.freeze_from = 0;
  recipe.head_from = 0.5;
  recipe.stages = {{0.2, 2, 0.5}, {0.4, 2, 1}};
  const auto second = trainer_of(recipe);
  ASSERT_TRUE(second->advance());
  ASSERT_TRUE(second->save(path));
  recipe.stages = {{0.4, 2, 1}};
  const auto first = trainer_of(recipe);
  ASSERT_TRUE(first->resume(path));
  ASSERT_TRUE(first->advance());
  ASSERT_TRUE(second->advance());
  EXPECT_TRUE(same_weights(*first, *second));
}

// However long the rest has been trained, the first average of the head is mostly the head.
TEST(Trainer, AveragesAHeadFromWhereItJoins) {
  Recipe recipe = small_recipe();
  recipe.steps = 40;
  recipe.head_from = 0.95;
  recipe.warm_up = 1;
  const auto trainer = trainer_of(recipe);
  for (int i = 0; i < 38; ++i) ASSERT_TRUE(trainer->advance());
  const torch::Tensor before = trainer->averaged()->head->conv1->weight.detach().clone();
  for (int i = 0; i < 2; ++i) ASSERT_TRUE(trainer->advance());
  const auto state = state_of(*trainer);
  const torch::Tensor trained = state.at("network.depth.head.conv1.weight");
  const torch::Tensor averaged = state.at("average.head.conv1.weight");
  EXPECT_LT((averaged - trained).norm().item<float>(),
            0.2 * (before - trained).norm().item<float>());
}

// At the step where the head joins, and at the end, what comes next is not what was trained.
TEST(Trainer, ScoresWhatItTrained) {
  Recipe recipe = small_recipe();
  recipe.steps = 4;
  recipe.stages = {{0.2, 2, 0.5}, {0.3, 2, 1}};
  recipe.head_from = 0.75;
  const auto trainer = trainer_of(recipe);
  const auto advance = [&] { ASSERT_TRUE(trainer->advance()); };
  advance();
  EXPECT_TRUE(trainer->update_best(0.5));
  advance();
  EXPECT_EQ(trainer->share(), 0.2);
  EXPECT_FALSE(trainer->update_best(0.6)) << "the first stage's too";
  advance();
  EXPECT_FALSE(trainer->has_head());
  EXPECT_TRUE(trainer->update_best(0.9)) << "of the second stage";
  advance();
  EXPECT_TRUE(trainer->has_head());
  recipe.head_from = 1;
  const auto without = trainer_of(recipe);
  while (!without->done()) ASSERT_TRUE(without->advance());
  EXPECT_FALSE(without->has_head());
}

// Everything of the paper at once on a moving camera: each term is there and the step is finite.
TEST(Trainer, TakesEveryLossOfThePaper) {
  Pack drive = scene_packs()[0];  // views of rendered worlds, all different, stand in for a drive
  std::vector<PackFrame> frames;
  for (std::size_t i = 0; i < drive.frames->size(); ++i) {
    frames.push_back(*drive.frames->read(2 * (i % 12)));  // every second frame is wide
    frames.back().name = std::to_string(i);
  }
  drive.frames = std::make_shared<MemoryFrames>(frames, true);
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

TEST(Trainer, RefusesACheckpointOfAnotherNetworkOrOptimiser) {
  const test::TemporaryFolder folder;
  const std::string path = folder.file("checkpoint.safetensors");
  Recipe recipe = small_recipe();
  ASSERT_TRUE(trainer_of(recipe)->save(path));
  recipe.optimizer = OptimizerKind::kMuon;
  EXPECT_EQ(trainer_of(recipe)->resume(path).code(), StatusCode::kInvalidInput);
  recipe.optimizer = OptimizerKind::kAdamW;
  recipe.encoder = EncoderKind::kXs;
  EXPECT_EQ(trainer_of(recipe)->resume(path).code(), StatusCode::kInvalidInput);
}

// Fine-tuning: the weights are the given ones, the steps are counted anew.
TEST(Trainer, StartsFromTrainedWeights) {
  Recipe recipe = small_recipe();
  const auto first = trainer_of(recipe);
  ASSERT_TRUE(first->advance());
  recipe.seed = 2;
  const auto second = trainer_of(recipe);
  EXPECT_FALSE(same_weights(*first, *second));
  ASSERT_TRUE(second->start_from(first->averaged(), NormStatistics::kKept));
  EXPECT_TRUE(same_weights(*first, *second));
  EXPECT_EQ(second->step(), 0);
  EXPECT_EQ(second->config().variable_mean, first->config().variable_mean);
  ModelConfig wider = first->config();
  wider.decoder_widths[0] *= 2;
  EXPECT_EQ(second->start_from(DepthNetwork(wider), NormStatistics::kKept).code(),
            StatusCode::kInvalidInput);
  EXPECT_EQ(second->config().start, StartKind::kNoise);
  DepthNetwork from_zeros(first->config());
  from_zeros->config.start = StartKind::kZeros;
  ASSERT_TRUE(second->start_from(from_zeros, NormStatistics::kKept));
  EXPECT_EQ(second->config().start, StartKind::kZeros) << "the weights learnt to start there";
  EXPECT_EQ(second->averaged()->config.start, StartKind::kZeros);
  recipe.start = StartKind::kNoise;
  const auto told = trainer_of(recipe);
  ASSERT_TRUE(told->start_from(from_zeros, NormStatistics::kKept));
  EXPECT_EQ(told->config().start, StartKind::kNoise) << "who says so gets it";
  recipe.encoder = EncoderKind::kXs;
  const auto larger = trainer_of(recipe);
  ASSERT_TRUE(larger->start_from(first->averaged(), NormStatistics::kKept));
  EXPECT_TRUE(larger->advance());
  EXPECT_EQ(second->start_from(larger->averaged(), NormStatistics::kKept).code(),
            StatusCode::kInvalidInput);
}

// ImageNet encoders come with statistics of pictures in [0, 1] or of mean 0: what leaves a norm
// here would be neither centred nor of unit size.
TEST(Trainer, MeasuresTheStatisticsOfAnImportedEncoder) {
  torch::manual_seed(3);
  MobileVit theirs(EncoderKind::kXxs);
  TensorFile file;
  collect(*theirs, "", file.tensors);
  const torch::NoGradGuard no_grad;
  for (auto& [name, tensor] : file.tensors) {
    if (name.find("running_mean") != std::string::npos) tensor.fill_(7);
  }
  file.metadata["licence"] = "theirs";
  const auto trainer = trainer_of(small_recipe());
  ASSERT_TRUE(trainer->start_encoder_from(file, ChannelOrder::kRgb));
  EXPECT_EQ(trainer->config().licence, "theirs") << "what made it asks for something too";
  ConvNorm& stem = trainer->averaged()->encoder->stem;
  EXPECT_TRUE(torch::equal(stem->bn->weight, theirs->stem->bn->weight)) << "the weights are theirs";
  const Batch batch = *make_batch(scene_packs(), {160, 64, 80, 8, true}, 5, 0);
  const torch::Tensor out = stem->bn->forward(stem->conv->forward(batch.rgb));
  EXPECT_LT(out.mean({0, 2, 3}).abs().max().item<float>(), 1);
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
