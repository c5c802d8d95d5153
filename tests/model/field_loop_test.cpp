// The field loop as its user walks it, with the real programs: record a drive, play it back as
// teacher depth, make a pack of it, train a few steps, export, and load what came out.
#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>
#include <iterator>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "firmware/nn/model_file.h"
#include "tests/app/program.h"
#include "tests/support/random_model.h"
#include "tests/support/temporary_folder.h"

namespace lcdm {
namespace {

namespace fs = std::filesystem;

class FieldLoopTest : public ::testing::Test {
 protected:
  void SetUp() override {
    const auto config = test::make_config(EncoderKind::kXxs, PresetKind::kLcdm);
    folder_.write("model.safetensors", test::make_random_model(config, test::kGoldenSeed));
  }

  std::string path(const std::string& name) const { return folder_.file(name); }

  // Runs a program to its end; the test stops with what it printed when it fails.
  static void run(const char* program, const std::vector<std::string>& arguments) {
    test::Program child(program, arguments);
    ASSERT_EQ(child.wait(180), 0) << child.text();
  }

  // Every picture of `small` is that of `large` at half its size, and so is the camera.
  static void expect_half_of(const fs::path& large, const fs::path& small) {
    for (const auto& file : fs::directory_iterator(small / "rgb")) {
      cv::Mat picture = cv::imread((large / "rgb" / file.path().filename()).string());
      cv::resize(picture, picture, {}, .5, .5, cv::INTER_AREA);
      const cv::Mat half = cv::imread(file.path().string());
      ASSERT_EQ(half.size(), picture.size());
      EXPECT_LT(cv::norm(half, picture, cv::NORM_L1) / static_cast<double>(3 * half.total()), 3);
    }
    const auto number = [](const fs::path& pack, const char* key) {
      const cv::FileStorage file((pack / "intrinsics.json").string(), cv::FileStorage::READ);
      return static_cast<double>(file[key]);
    };
    EXPECT_DOUBLE_EQ(number(small, "width"), 160);
    EXPECT_NEAR(number(small, "fx"), number(large, "fx") / 2, 1e-3);
    EXPECT_NEAR(number(small, "cy"), (number(large, "cy") + .5) / 2 - .5, 1e-3);
  }

  static std::size_t files_in(const fs::path& folder) {
    return static_cast<std::size_t>(
        std::distance(fs::directory_iterator(folder), fs::directory_iterator()));
  }

  test::TemporaryFolder folder_;
};

TEST_F(FieldLoopTest, ADriveIsRecordedReplayedTrainedOnAndExported) {
  run(LCDM_PROGRAM, {"record", "--source", "scene:3", "--output", path("drive"), "--seconds", "2",
                     "--set", "camera.width=320", "--set", "camera.height=240"});
  ASSERT_EQ(files_in(path("drive")), 1U);

  run(LCDM_TRAIN_PROGRAM, {"pack", "--recording", path("drive"), "--output", path("pack")});
  run(LCDM_PROGRAM,
      {"infer", "--source", "mcap:" + path("drive"), "--output", path("pack/depth"), "--model",
       path("model.safetensors"), "--set", "model.width=128", "--set", "model.height=96"});
  const std::size_t pictures = files_in(path("pack/rgb"));
  EXPECT_GE(pictures, 10U);
  EXPECT_EQ(files_in(path("pack/depth")), pictures);  // one depth for every picture
  test::Program again(LCDM_TRAIN_PROGRAM,
                      {"pack", "--recording", path("drive"), "--output", path("pack")});
  EXPECT_EQ(again.wait(60), 2) << "another recording's pictures would mix with these";

  run(LCDM_TRAIN_PROGRAM, {"pack", "--recording", path("drive"), "--output", path("small"),
                           "--every", "2", "--width", "160"});
  EXPECT_EQ(files_in(path("small/rgb")), (pictures + 1) / 2);
  expect_half_of(path("pack"), path("small"));

  run(LCDM_TRAIN_PROGRAM,
      {"train", "--pack", path("pack"), "--scene-frames", "0", "--encoder", "xxs", "--steps", "3",
       "--stage", "0.3:2:1", "--output", path("training"), "--from", path("model.safetensors"),
       "--freeze-from", "0"});
  run(LCDM_TRAIN_PROGRAM,
      {"export", "--checkpoint", path("training/checkpoint.safetensors"), "--output",
       path("tuned.safetensors"), "--name", "field loop", "--card", "three steps of a test"});
  run(LCDM_PROGRAM, {"inspect", "model", path("tuned.safetensors")});
  const auto tuned = ModelFile::load(path("tuned.safetensors"));
  ASSERT_TRUE(tuned) << tuned.status().text();
  EXPECT_EQ(tuned->config().name, "field loop");
  EXPECT_EQ(tuned->config().licence,  // what data and first weights ask for
            "that of the trainer's own pictures; started from weights under: Apache-2.0");

  // It teaches in turn, and is compared on a page, whose curve of two runs is one line.
  run(LCDM_TRAIN_PROGRAM, {"teach", "--pack", path("pack"), "--model", path("tuned.safetensors")});
  EXPECT_EQ(files_in(path("pack/teacher")), pictures + 1);  // and teacher.json
  std::ofstream(path("curve.csv"))
      << "run,step,distillation\n1,400,.5\n1,800,.4\n2,200,.3\n2,900,.2\n";
  run(LCDM_TRAIN_PROGRAM, {"report", "--pack", path("pack"), "--model", path("tuned.safetensors"),
                           "--curve", path("curve.csv"), "--output", path("page.html")});
  std::ifstream file(path("page.html"));
  const std::string page{std::istreambuf_iterator<char>(file), {}};
  EXPECT_NE(page.find(">distillation<"), std::string::npos);
  EXPECT_EQ(page.find(">run<"), std::string::npos) << "no loss";
  EXPECT_NE(page.find(">1\u202F600<"), std::string::npos) << "steps after the first run's 800";
}

}  // namespace
}  // namespace lcdm
