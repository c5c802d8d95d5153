// What a training starts from, keeps and goes on with: weights of others, statistics, checkpoints.
#include <gtest/gtest.h>

#include "model/checkpoint.h"
#include "model/safetensors.h"
#include "tests/model/small_training.h"
#include "tests/support/temporary_folder.h"

namespace lcdm::model {
namespace {

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
  const Status status = resumed->resume(path).status();
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

// One of two, whose other one sends the same and goes after `steps` steps.
class Deserted final : public Processes {
 public:
  explicit Deserted(int steps) : left_(steps) {}
  int rank() const override { return 0; }
  int size() const override { return 2; }
  Status sum(torch::Tensor& values) override {
    if (left_-- == 0) return Status::error(StatusCode::kUnavailable, "gone");
    values.mul_(2);
    return Status::ok();
  }

 private:
  int left_;
};

// Gradients and statistics of its own part are made by then.
TEST(Trainer, IsAsBeforeTheStepInWhichAnotherProcessGoes) {
  at::set_num_threads(1);
  Compute compute = one_cpu();
  compute.processes = std::make_shared<Deserted>(2);
  Recipe recipe = small_recipe();
  recipe.workers = 2;
  const auto trainer = Trainer::make(recipe, scene_packs(), compute);
  ASSERT_TRUE(trainer) << trainer.status().text();
  for (int i = 0; i < 2; ++i) ASSERT_TRUE((*trainer)->advance());
  const auto before = state_of(**trainer);
  EXPECT_EQ((*trainer)->advance().code(), StatusCode::kUnavailable);
  EXPECT_EQ((*trainer)->step(), 2);
  for (const auto& [name, tensor] : state_of(**trainer)) {
    EXPECT_TRUE(torch::equal(tensor, before.at(name))) << name;
  }
}

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
  EXPECT_FALSE(trainer->update_best(INFINITY)) << "nothing was measured";
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

TEST(Trainer, SaysWhatDiffersFromTheTrainingItGoesOnWith) {
  const test::TemporaryFolder folder;
  const std::string path = folder.file("checkpoint.safetensors");
  Recipe recipe = small_recipe();
  std::vector<Pack> packs = scene_packs();
  packs[0].use.name = "k\u00fcche";
  ASSERT_TRUE(trainer_of(recipe, packs)->save(path));
  EXPECT_EQ(*trainer_of(recipe, packs)->resume(path), "");
  recipe.steps = 8;
  packs[0].use.name = "other";
  packs[0].use.photographs = 7;
  const Result<std::string> changed = trainer_of(recipe, packs)->resume(path);
  ASSERT_TRUE(changed) << changed.status().text();
  for (const char* line :
       {"then: steps = 6", "now:  steps = 8", "now:  trains on 24 frames of other",
        "now:  medleys painted with 7 photographs"}) {
    EXPECT_NE(changed->find(line), std::string::npos) << line << " is not in\n" << *changed;
  }
  EXPECT_EQ(std::count(changed->begin(), changed->end(), '\n'), 6);
}

TEST(Trainer, RefusesACheckpointOfAnotherNetworkOrOptimiser) {
  const test::TemporaryFolder folder;
  const std::string path = folder.file("checkpoint.safetensors");
  Recipe recipe = small_recipe();
  ASSERT_TRUE(trainer_of(recipe)->save(path));
  recipe.optimizer = OptimizerKind::kMuon;
  EXPECT_EQ(trainer_of(recipe)->resume(path).status().code(), StatusCode::kInvalidInput);
  recipe.optimizer = OptimizerKind::kAdamW;
  recipe.encoder = EncoderKind::kXs;
  EXPECT_EQ(trainer_of(recipe)->resume(path).status().code(), StatusCode::kInvalidInput);
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

}  // namespace
}  // namespace lcdm::model
