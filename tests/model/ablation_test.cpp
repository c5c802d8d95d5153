// The paper's tables as rows of trainings, and a small one run whole, stopped and gone on with.
#include "model/ablation.h"

#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>

#include "model/csv.h"
#include "model/scene_pack.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;

TEST(AblationRows, AreThoseOfTheTables) {
  const std::vector<AblationRow> rows = ablation_rows({}, {"losses", "steps", "normals"});
  ASSERT_EQ(rows.size(), 5U + 1 + 4);
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
  EXPECT_EQ(rows[6].losses.normals, 0.1);
}

TEST(Ablation, GoesOnWhereItStopped) {
  at::set_num_threads(1);
  const fs::path folder = fs::path(testing::TempDir()) / "lcdm-ablation";
  fs::remove_all(folder);
  ScenePackOptions scene;
  scene.train_frames = 4;
  scene.validation_frames = 2;
  Data data;
  data.packs = {rendered_pack(scene)};
  data.protocols = {*protocol_named("scene")};
  Recipe recipe;
  recipe.encoder = EncoderKind::kXxs;
  recipe.steps = 2;
  recipe.stages = {{0.2, 2, 1}};
  recipe.workers = 1;
  AblationOptions options;
  options.folder = folder.string();
  options.tables = {"steps"};
  options.seeds = 2;
  const Status status = ablate(recipe, data, one_cpu(), options);
  ASSERT_TRUE(status) << status.text();
  const Result<CsvTable> table = read_csv((folder / "ablation.csv").string());
  ASSERT_TRUE(table) << table.status().text();
  EXPECT_EQ(table->rows.size(), 2U * 6);  // seeds x numbers of steps
  std::ifstream page(folder / "ablation.html");
  const std::string text{std::istreambuf_iterator<char>(page), {}};
  EXPECT_NE(text.find("±"), std::string::npos);

  // Again: nothing is trained, the figures are the same.
  const fs::path checkpoint = folder / "ID5-all-seed1" / "checkpoint.safetensors";
  const auto written = fs::last_write_time(checkpoint);
  ASSERT_TRUE(ablate(recipe, data, one_cpu(), options));
  EXPECT_EQ(fs::last_write_time(checkpoint), written);
  EXPECT_EQ(read_csv((folder / "ablation.csv").string())->rows, table->rows);
  fs::remove_all(folder);
}

}  // namespace
}  // namespace lcdm::model
