// The paper's tables as rows of trainings, and a small one run whole, stopped and gone on with.
#include "model/ablation.h"

#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>

#include "model/csv.h"
#include "model/safetensors.h"
#include "model/scene_pack.h"
#include "tests/model/small_training.h"
#include "tests/support/temporary_folder.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;

TEST(AblationRows, AreThoseOfTheTables) {
  const std::vector<AblationRow> rows =
      ablation_rows({}, {"losses", "steps", "normals", "sampler"});
  ASSERT_EQ(rows.size(), 5U + 1 + 6 + 4);
  const LossWeights& first = rows[0].losses;
  EXPECT_EQ(first.photometric, 1);
  EXPECT_EQ(first.denoising + first.distillation + first.normals + first.gradient, 0);
  EXPECT_EQ(rows[1].losses.denoising, 1);
  EXPECT_EQ(rows[2].losses.distillation, 1);
  EXPECT_EQ(rows[3].losses.distillation, 0);
  EXPECT_EQ(rows[3].losses.normals, 1);
  const LossWeights& all = rows[4].losses;
  EXPECT_EQ(all.photometric * all.denoising * all.distillation * all.normals, 1);
  EXPECT_EQ(rows[5].steps, (std::vector<int>{0, 1, 2, 3, 5, 10}));
  EXPECT_EQ(rows[6].losses.normals, 0);
  EXPECT_EQ(rows[6].name, rows[2].name) << "the same network, trained once";
  EXPECT_EQ(rows[7].losses.normals, 0.1);
  EXPECT_EQ(rows[9].losses.normals, 1);
  EXPECT_EQ(rows[9].name, rows[4].name);
  EXPECT_EQ(rows[12].preset, PresetKind::kPaper);
  EXPECT_NE(rows[12].name, rows[4].name);
  EXPECT_TRUE(rows[12].first_alone);
  EXPECT_FALSE(rows[13].first_alone);
  EXPECT_EQ(rows[14].preset, PresetKind::kLcdm);
  EXPECT_EQ(rows[14].name, rows[4].name);
}

// Two seeds of one network on a few rendered frames, two steps each.
class Ablation : public testing::Test {
 protected:
  void SetUp() override {
    at::set_num_threads(1);
    ScenePackOptions scene;
    scene.train_frames = 4;
    scene.validation_frames = 2;
    data_.packs = {as_video(rendered_pack(scene))};
    data_.packs[0].use.name = "scene, \"small\"";
    data_.protocols = {*protocol_named("scene")};
    recipe_.encoder = EncoderKind::kXxs;
    recipe_.steps = 2;
    recipe_.stages = {{0.2, 2, 1}};
    recipe_.workers = 1;
    options_.folder = folder_.string();
    options_.tables = {"steps"};
    options_.seeds = 2;
  }

  Status run() { return ablate(recipe_, data_, one_cpu(), options_); }
  std::map<std::string, torch::Tensor> weights() {
    return read_tensors(checkpoint_.string())->tensors;
  }
  // Of ablation.csv; empty where it cannot be read.
  std::vector<double> column(const char* name) const {
    const Result<CsvTable> table = read_csv(table_.string());
    EXPECT_TRUE(table) << table.status().text();
    return table ? table->numbers(name).value() : std::vector<double>();
  }

  test::TemporaryFolder scratch_;
  const fs::path folder_ = scratch_.file("tables");
  const fs::path table_ = folder_ / "ablation.csv";
  const fs::path checkpoint_ = folder_ / "ID5-all-seed1" / "checkpoint.safetensors";
  Data data_;
  Recipe recipe_;
  AblationOptions options_;
};

TEST_F(Ablation, WritesTheTableAndDoesNothingTwice) {
  const Status status = run();
  ASSERT_TRUE(status) << status.text();
  const Result<CsvTable> table = read_csv(table_.string());
  ASSERT_TRUE(table) << table.status().text();
  EXPECT_EQ(table->rows.size(), 2U * 6);  // seeds x numbers of steps
  EXPECT_EQ(table->texts("set")->front(), data_.packs[0].use.name);
  std::ifstream page(folder_ / "ablation.html");
  const std::string text{std::istreambuf_iterator<char>(page), {}};
  EXPECT_NE(text.find("±"), std::string::npos);
  EXPECT_NE(text.find("GMAC"), std::string::npos);

  const auto written = fs::last_write_time(checkpoint_);
  const std::vector<double> abs_rel = column("abs_rel");
  ASSERT_TRUE(run());
  EXPECT_EQ(fs::last_write_time(checkpoint_), written);
  EXPECT_EQ(column("abs_rel"), abs_rel);
}

// A step is the head again: 16 channels to 16, embedded and read from one, 3x3 each.
TEST_F(Ablation, SaysWhatAFrameCosts) {
  options_.seeds = 1;
  ASSERT_TRUE(run());
  const std::vector<double> steps = column("steps");
  const std::vector<double> gmac = column("gmac");
  ASSERT_EQ(steps, (std::vector<double>{0, 1, 2, 3, 5, 10}));
  const double step = 1e-9 * 128 * 64 * 9 * (16 * 16 + 16 + 16);
  for (std::size_t i = 2; i < steps.size(); ++i) {
    EXPECT_NEAR(gmac[i] - gmac[1], step * (steps[i] - 1), 1e-5) << steps[i];
  }
  EXPECT_NEAR(gmac[1] - gmac[0], step - 1e-9 * 128 * 64 * 9 * 16, 1e-5);
  for (const double milliseconds : column("milliseconds")) EXPECT_GT(milliseconds, 0);
}

// MODEL.md section 3: two steps of the paper's sampler are its first alone, and not of ours.
TEST_F(Ablation, ShowsThatThePapersSecondStepDoesNothing) {
  options_.tables = {"sampler"};
  options_.seeds = 1;
  ASSERT_TRUE(run());
  const std::vector<double> abs_rel = column("abs_rel");
  ASSERT_EQ(abs_rel.size(), 4U);
  EXPECT_NEAR(abs_rel[1], abs_rel[0], 0.02 * abs_rel[0]);
  EXPECT_GT(std::abs(abs_rel[3] - abs_rel[2]), 0.02 * abs_rel[2]);
}

// Stopped after one step of two, it ends where it would have.
TEST_F(Ablation, GoesOnWhereItStopped) {
  options_.seeds = 1;
  ASSERT_TRUE(run());
  const auto unbroken = weights();
  Recipe first = recipe_;
  first.losses = ablation_rows(recipe_, {"steps"})[0].losses;
  const auto trainer = Trainer::make(first, data_.packs, one_cpu());
  ASSERT_TRUE(trainer);
  ASSERT_TRUE((*trainer)->advance());
  ASSERT_TRUE((*trainer)->save(checkpoint_.string()));
  ASSERT_TRUE(run());
  for (const auto& [name, tensor] : weights()) {
    EXPECT_TRUE(torch::equal(tensor, unbroken.at(name))) << name;
  }
}

TEST_F(Ablation, RefusesTheNetworksOfAnotherRecipe) {
  options_.seeds = 1;
  ASSERT_TRUE(run());
  recipe_.losses.gradient *= 2;
  const Status status = run();
  EXPECT_EQ(status.code(), StatusCode::kInvalidInput);
  EXPECT_NE(std::string(status.text()).find("another recipe"), std::string::npos) << status.text();
}

TEST_F(Ablation, RefusesTheNetworksOfOtherData) {
  options_.seeds = 1;
  ASSERT_TRUE(run());
  const Data data = data_;
  for (float PackUse::*what : {&PackUse::weight, &PackUse::tall_share, &PackUse::things}) {
    data_ = data;
    data_.packs[0].use.*what += 0.5F;
    EXPECT_EQ(run().code(), StatusCode::kInvalidInput);
  }
  data_ = data;
  data_.packs[0].use.photographs = 7;
  EXPECT_EQ(run().code(), StatusCode::kInvalidInput);
}

}  // namespace
}  // namespace lcdm::model
