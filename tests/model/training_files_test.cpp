// What a training leaves on the disk survives crashes, full disks and files that were cut.
#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>

#include "model/csv.h"
#include "model/safetensors.h"
#include "model/training_log.h"
#include "tests/model/small_training.h"
#include "tests/support/file_size_limit.h"
#include "tests/support/temporary_folder.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;

// A crash cut the last line and left rows that will be done again.
TEST(TrainingLog, GoesOnFromTheStepOfTheCheckpoint) {
  const test::TemporaryFolder scratch;
  const fs::path folder = scratch.path();
  std::ofstream(folder / "curve.csv") << "step,a\n25,1\n50,2\n75,3\n10";
  {
    const TrainingLog log(folder, 50, 100);
    EXPECT_EQ(read_csv((folder / "curve.csv").string())->rows.size(), 2U)
        << "kept on the disk before anything is added";
  }
  const Result<CsvTable> curve = read_csv((folder / "curve.csv").string());
  ASSERT_TRUE(curve) << curve.status().text();
  EXPECT_EQ(*curve->numbers("step"), (std::vector<double>{25, 50}));
  { const TrainingLog log(folder, 0, 100); }
  EXPECT_TRUE(read_csv((folder / "curve.csv").string())->rows.empty());
}

// The time of a training is that of all its parts.
TEST(TrainingLog, SecondsGoOnFromTheLastRowThatIsKept) {
  const test::TemporaryFolder scratch;
  const fs::path folder = scratch.path();
  const fs::path curve = folder / "curve.csv";
  { const TrainingLog log(folder, 0, 2); }
  std::ofstream(curve, std::ios::app) << "1,2,1000.0,0,0,0,0,0,0,0,0\n2,4,2000.0,0,0,0,0,0,0,0,0\n";
  Recipe recipe = small_recipe();
  recipe.steps = 2;
  const auto trainer = trainer_of(recipe);
  ASSERT_TRUE(trainer->advance());
  TrainingLog log(folder, 1, 2);
  const Result<Losses> losses = trainer->advance();
  ASSERT_TRUE(losses) << losses.status().text();
  log.add(*trainer, *losses);
  const Result<CsvTable> table = read_csv(curve.string());
  ASSERT_TRUE(table) << table.status().text();
  ASSERT_EQ(*table->numbers("step"), (std::vector<double>{1, 2}));
  EXPECT_GE(table->numbers("seconds")->back(), 1000);
  EXPECT_LT(table->numbers("seconds")->back(), 1900);
}

TEST(TrainingLog, ASetMayHaveAnyName) {
  const test::TemporaryFolder scratch;
  const fs::path folder = scratch.path();
  const auto trainer = trainer_of(small_recipe());
  Validation validation;
  validation.sets.resize(2);
  validation.sets[0].name = "kitchen, \"north\"";
  validation.sets[1].name = "cellar\n9";
  { TrainingLog(folder, 0, 6).add(*trainer, validation, false); }
  const TrainingLog resumed(folder, 0, 6);  // which reads and keeps them
  const Result<CsvTable> table = read_csv((folder / "validation.csv").string());
  ASSERT_TRUE(table) << table.status().text();
  EXPECT_EQ(*table->texts("set"),
            (std::vector<std::string>{validation.sets[0].name, validation.sets[1].name}));
}

TEST(TrainingLog, FullDiskLeavesTheCurve) {
  const test::TemporaryFolder scratch;
  const fs::path folder = scratch.path();
  std::ofstream(folder / "curve.csv") << "step,a\n25,1\n50,2\n";
  {
    const test::FileSizeLimit limit(5);
    const TrainingLog log(folder, 25, 100);
  }
  EXPECT_EQ(read_csv((folder / "curve.csv").string())->rows.size(), 2U);
}

TEST(TrainingLog, SaysWhereItCannotBeWritten) {
  const test::TemporaryFolder scratch;
  const fs::path folder = scratch.path();
  fs::create_directories(folder / "curve.csv" / "not_a_file");
  testing::internal::CaptureStderr();
  { const TrainingLog log(folder, 0, 100); }
  EXPECT_NE(testing::internal::GetCapturedStderr().find("curve.csv"), std::string::npos);
}

TEST(Checkpoint, FullDiskLeavesTheOldOne) {
  const test::TemporaryFolder scratch;
  const std::string path = scratch.file("checkpoint.safetensors");
  std::ofstream(path) << "old";
  {
    const test::FileSizeLimit limit(1000);
    const Status status = write_tensors(path, {{{"a", torch::zeros({1000})}}, {}});
    EXPECT_EQ(status.code(), StatusCode::kIoError);
  }
  std::string text;
  std::ifstream(path) >> text;
  EXPECT_EQ(text, "old");
}

TEST(Checkpoint, TruncatedFilesAreRefused) {
  const test::TemporaryFolder scratch;
  const std::string path = scratch.file("truncated.safetensors");
  ASSERT_TRUE(write_tensors(path, {{{"a", torch::zeros({1000})}}, {{"key", "a \"value\""}}}));
  const Result<TensorFile> whole = read_tensors(path);
  ASSERT_TRUE(whole);
  EXPECT_EQ(whole->metadata.at("key"), "a \"value\"");
  for (const std::uintmax_t size : {0U, 7U, 20U, 500U, 4000U}) {
    fs::resize_file(path, size);
    EXPECT_EQ(read_tensors(path).code(), StatusCode::kInvalidInput) << size;
    ASSERT_TRUE(write_tensors(path, {{{"a", torch::zeros({1000})}}, {}}));
  }
}

}  // namespace
}  // namespace lcdm::model
