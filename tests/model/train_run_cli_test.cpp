// A training as its user starts, stops and goes on with it, with the real program.
#include <csignal>
#include <filesystem>
#include <fstream>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <iterator>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "tests/app/program.h"
#include "tests/support/temporary_folder.h"

namespace lcdm {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;
using testing::Not;

constexpr int kPictures = 1600;  // of a pack: too many to be kept in memory

std::string bytes_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

class TrainRun : public testing::Test {
 protected:
  // Who runs the tests may ignore it, as nohup does.
  void SetUp() override { std::signal(SIGHUP, SIG_DFL); }

  // Of a few rendered frames, some hundredths of a second a step; its first line comes after 25.
  std::vector<std::string> training(const std::string& output, int steps,
                                    const std::vector<std::string>& more = {}) const {
    std::vector<std::string> all = {
        "train",     "--data", catalogue_,    "--encoder", "xxs",          "--stage", "0.2:1:1",
        "--workers", "1",      "--head-from", "0",         "--save-every", "100000"};
    all.insert(all.end(), {"--steps", std::to_string(steps), "--output", folder_.file(output)});
    all.insert(all.end(), more.begin(), more.end());
    return all;
  }
  std::string checkpoint(const std::string& output) const {
    return folder_.file(output) + "/checkpoint.safetensors";
  }

  // One picture under many names.
  std::string write_pack() const {
    const fs::path pack = folder_.file("pack");
    fs::remove_all(pack);
    for (const char* kind : {"rgb", "depth"}) fs::create_directories(pack / kind);
    cv::Mat rgb(96, 128, CV_8UC3);
    cv::Mat depth(96, 128, CV_16U);
    cv::randu(rgb, 0, 256);
    cv::randu(depth, 1000, 3000);
    cv::imwrite((pack / "rgb/0.png").string(), rgb);
    cv::imwrite((pack / "depth/0.png").string(), depth);
    for (int i = 1; i < kPictures; ++i) {
      for (const char* kind : {"rgb", "depth"}) {
        fs::create_hard_link(pack / kind / "0.png", pack / kind / (std::to_string(i) + ".png"));
      }
    }
    std::ofstream(pack / "intrinsics.json")
        << "{\"width\": 128, \"height\": 96, \"depth_unit_m\": 0.001, \"fx\": 100, \"fy\": 100, "
           "\"cx\": 64, \"cy\": 48}";
    return pack.string();
  }

  test::TemporaryFolder folder_;
  const std::string catalogue_ = folder_.write("scene.toml", "[scene]\nframes = 8\n");
};

TEST_F(TrainRun, StoppedAndResumedItEndsAsAnUnbrokenOne) {
  test::Program unbroken(LCDM_TRAIN_PROGRAM, training("unbroken", 60));
  ASSERT_EQ(unbroken.wait(120), 0) << unbroken.text();
  test::Program stopped(LCDM_TRAIN_PROGRAM, training("broken", 60));
  ASSERT_TRUE(stopped.wait_for("25/60", 60)) << stopped.text();
  kill(stopped.pid(), SIGTERM);
  ASSERT_EQ(stopped.wait(), 0) << stopped.text();
  ASSERT_THAT(stopped.text(), Not(HasSubstr("60/60")));
  ASSERT_TRUE(fs::exists(checkpoint("broken")));
  test::Program resumed(LCDM_TRAIN_PROGRAM, training("broken", 60, {"--resume"}));
  ASSERT_EQ(resumed.wait(120), 0) << resumed.text();
  EXPECT_THAT(resumed.text(), Not(HasSubstr("from step 0")));
  EXPECT_TRUE(bytes_of(checkpoint("broken")) == bytes_of(checkpoint("unbroken")));
}

TEST_F(TrainRun, AClosedTerminalSavesAndStops) {
  test::Program program(LCDM_TRAIN_PROGRAM, training("run", 100000));
  ASSERT_TRUE(program.wait_for("25/100000", 60)) << program.text();
  kill(program.pid(), SIGHUP);
  EXPECT_EQ(program.wait(), 0) << program.text();
  EXPECT_TRUE(fs::exists(checkpoint("run")));
}

TEST_F(TrainRun, UnderNohupAClosedTerminalIsNothing) {
  std::signal(SIGHUP, SIG_IGN);
  test::Program program(LCDM_TRAIN_PROGRAM, training("run", 50));
  ASSERT_TRUE(program.wait_for("25/50", 60)) << program.text();
  kill(program.pid(), SIGHUP);
  EXPECT_EQ(program.wait(), 0) << program.text();
  EXPECT_THAT(program.text(), HasSubstr("50/50"));
}

// As `train | head -n 1` does.
TEST_F(TrainRun, ItTrainsOnWhenNobodyReadsWhatItPrints) {
  std::vector<std::string> piped = {"-c", "\"$@\" | head -n 1", "sh", LCDM_TRAIN_PROGRAM};
  const std::vector<std::string> all = training("run", 75);
  piped.insert(piped.end(), all.begin(), all.end());
  test::Program program("/bin/sh", piped);
  EXPECT_EQ(program.wait(120), 0) << program.text();
  EXPECT_TRUE(fs::exists(checkpoint("run"))) << program.text();
}

// All of it at once, and so many frames that it is no longer a damaged file or two.
TEST_F(TrainRun, DataThatGoesAwayCostsNoStep) {
  for (const int part : {2, 1}) {
    const std::string pack = write_pack();
    const std::string output = "run" + std::to_string(part);
    const std::vector<std::string> more = {"--pack", pack, "--scene-frames", "0"};
    test::Program program(LCDM_TRAIN_PROGRAM, training(output, 100000, more));
    ASSERT_TRUE(program.wait_for("25/100000", 60)) << program.text();
    for (int i = 0; i < kPictures; i += part) {
      fs::remove(pack + "/rgb/" + std::to_string(i) + ".png");
    }
    EXPECT_EQ(program.wait(), 1) << program.text();
    EXPECT_THAT(program.text(), HasSubstr("go on with --resume"));
    EXPECT_TRUE(fs::exists(checkpoint(output)));
  }
}

TEST_F(TrainRun, ResumedItSaysThatItDoesNotStartFromOtherWeights) {
  const std::string other = checkpoint("other");
  for (const char* output : {"other", "run"}) {
    test::Program program(LCDM_TRAIN_PROGRAM, training(output, 1));
    ASSERT_EQ(program.wait(), 0) << program.text();
  }
  test::Program resumed(LCDM_TRAIN_PROGRAM, training("run", 2, {"--from", other, "--resume"}));
  EXPECT_EQ(resumed.wait(), 0) << resumed.text();
  EXPECT_THAT(resumed.text(), HasSubstr(other + " is not used with --resume"));
}

// Its tables come of whole trainings only.
TEST_F(TrainRun, AnAblationThatIsStoppedGoesOnWhereItWas) {
  const std::string tables = folder_.file("tables");
  const std::vector<std::string> ablate = {
      "ablate",  "--pack",    write_pack(), "--video", "--scene-frames", "0",         "--every",
      "40",      "--encoder", "xxs",        "--stage", "0.2:2:1",        "--workers", "1",
      "--steps", "60",        "--tables",   "steps",   "--output",       tables};
  test::Program stopped(LCDM_TRAIN_PROGRAM, ablate);
  ASSERT_TRUE(stopped.wait_for("25/60", 60)) << stopped.text();
  kill(stopped.pid(), SIGHUP);
  ASSERT_EQ(stopped.wait(), 0) << stopped.text();
  EXPECT_TRUE(fs::exists(tables + "/ID5-all-seed1/checkpoint.safetensors"));
  EXPECT_FALSE(fs::exists(tables + "/ablation.csv"));
  test::Program resumed(LCDM_TRAIN_PROGRAM, ablate);
  ASSERT_EQ(resumed.wait(120), 0) << resumed.text();
  EXPECT_THAT(resumed.text(), Not(HasSubstr("25/60")));
  EXPECT_THAT(resumed.text(), HasSubstr("60/60"));
  EXPECT_TRUE(fs::exists(tables + "/ablation.csv"));
}

TEST_F(TrainRun, ADryRunSaysWhatItWouldTakeAndLeavesNothing) {
  test::Program program(LCDM_TRAIN_PROGRAM, training("run", 1000, {"--dry-run"}));
  ASSERT_EQ(program.wait(), 0) << program.text();
  for (const char* said : {"1000 steps", "M parameters", "GMAC with 2 sampling steps",
                           "host memory", "expected time"}) {
    EXPECT_THAT(program.text(), HasSubstr(said));
  }
  EXPECT_FALSE(fs::exists(folder_.file("run")));
}

}  // namespace
}  // namespace lcdm
