// Teachers that others trained, as TorchScript modules written here.
#include "model/torchscript_teacher.h"

#include <filesystem>
#include <gtest/gtest.h>
#include <torch/script.h>

#include "tests/app/program.h"
#include "tests/support/temporary_folder.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;
using Gives = TorchscriptOptions::Gives;

class TorchscriptTeacher : public testing::Test {
 protected:
  // A module with this forward().
  Result<Estimator> load(const std::string& forward, Gives gives) {
    torch::jit::Module module("Teacher");
    module.define(forward);
    module.save(path_);
    TorchscriptOptions options;
    options.file = path_;
    options.input = {64, 32};
    options.pixels = kUnitPixels;
    options.gives = gives;
    return torchscript_estimator(options);
  }
  // Red grows from left to right: 0, then 51, 102, 153, 204, 255 in equal bars.
  static PackFrame bars() {
    PackFrame frame;
    frame.rgb = cv::Mat::zeros(32, 66, CV_8UC3);
    for (int x = 0; x < 66; ++x) frame.rgb.col(x).setTo(cv::Scalar(51 * (x / 11), 0, 0));
    return frame;
  }

  test::TemporaryFolder folder_;
  const std::string path_ = folder_.file("teacher.pt");
};

TEST_F(TorchscriptTeacher, GivesItsDepthInMetres) {
  const auto teacher = load("def forward(self, x):\n  return x[:, 0:1] * 10 + 1\n", Gives::kDepth);
  ASSERT_TRUE(teacher) << teacher.status().text();
  const cv::Mat depth = (*teacher)(bars());
  ASSERT_EQ(depth.size(), cv::Size(64, 32));
  EXPECT_NEAR(depth.at<float>(16, 2), 1, 1e-4);
  EXPECT_NEAR(depth.at<float>(16, 61), 11, 1e-4);
}

TEST_F(TorchscriptTeacher, InverseDepthIsTurnedAround) {
  const auto teacher =
      load("def forward(self, x):\n  return (x[:, 0] * 0.5 + 0.5, x)\n", Gives::kInverse);
  ASSERT_TRUE(teacher) << teacher.status().text();
  const cv::Mat depth = (*teacher)(bars());
  EXPECT_NEAR(depth.at<float>(16, 2), 2, 1e-4);
  EXPECT_NEAR(depth.at<float>(16, 61), 1, 1e-4);
}

// Stored in 1/256 m, a hundredth of a metre would be two steps.
TEST(AtTenMetres, MovesTheMedianAndKeepsHolesAndRatios) {
  const cv::Mat map = (cv::Mat_<float>(1, 4) << 0, 0.01F, 0.03F, 0.3F);
  const cv::Mat out = at_ten_metres(map);
  EXPECT_EQ(out.at<float>(0, 0), 0);
  EXPECT_NEAR(out.at<float>(0, 1), 10.0 / 3, 1e-4);
  EXPECT_NEAR(out.at<float>(0, 2), 10, 1e-4);
  EXPECT_NEAR(out.at<float>(0, 3), 100, 1e-3);
  EXPECT_TRUE(at_ten_metres({}).empty()) << "no answer stays none";
}

// Whatever its scale and shift, near stays near and a shift and scale of inverse depth brings back.
TEST_F(TorchscriptTeacher, AffineInverseDepthIsSpreadOverTheRange) {
  const auto teacher =
      load("def forward(self, x):\n  return x[:, 0:1] * 400 - 70\n", Gives::kAffineInverse);
  ASSERT_TRUE(teacher) << teacher.status().text();
  const cv::Mat depth = (*teacher)(bars());
  EXPECT_NEAR(depth.at<float>(16, 2), 100, 1e-2);
  EXPECT_NEAR(depth.at<float>(16, 61), 1, 1e-4);
  EXPECT_NEAR(1 / depth.at<float>(16, 28), 0.01 + 0.99 * 0.4, 1e-3);  // red 102 of 255
}

TEST_F(TorchscriptTeacher, WhatIsNoTeacherIsSaidSo) {
  EXPECT_EQ(load("def forward(self, x):\n  return x.mean()\n", Gives::kDepth).code(),
            StatusCode::kCorrupt);
  EXPECT_EQ(load("def forward(self, x):\n  return x[:, 7:9]\n", Gives::kDepth).code(),
            StatusCode::kCorrupt);
  TorchscriptOptions options;
  options.file = path_;
  options.input = {64, 32};
  fs::resize_file(path_, 100);
  EXPECT_EQ(torchscript_estimator(options).code(), StatusCode::kInvalidInput);
}

// The published checkpoint's form, converted by our script: disparity 0.5 red + 0.25 of 0.1 to 100
// m.
TEST(MonoVit, CheckpointBecomesATeacher) {
  const char* python = "/usr/bin/python3";
  if (test::Program(python, {"-c", "import torch"}).wait(60) != 0) {
    GTEST_SKIP() << "python3-torch is not installed";
  }
  const test::TemporaryFolder folder;
  test::Program weights(python, {"tests/fixtures/monovit/write_weights.py", folder.path()});
  ASSERT_EQ(weights.wait(60), 0) << weights.text();
  const std::string module = folder.file("teacher.pt");
  test::Program convert(
      python, {"model/teachers/monovit_to_torchscript.py", "--repository", "tests/fixtures/monovit",
               "--weights", folder.path(), "--output", module});
  ASSERT_EQ(convert.wait(60), 0) << convert.text();

  TorchscriptOptions options;
  options.file = module;
  options.input = {64, 32};
  options.pixels = kUnitPixels;
  options.gives = Gives::kInverse;
  const auto teacher = torchscript_estimator(options);
  ASSERT_TRUE(teacher) << teacher.status().text();
  PackFrame frame;
  frame.rgb = cv::Mat(32, 64, CV_8UC3, cv::Scalar(102, 0, 0));  // red 0.4
  const double inverse = 0.01 + 9.99 * (0.5 * 0.4 + 0.25);
  EXPECT_NEAR((*teacher)(frame).at<float>(16, 30), 1 / inverse, 1e-5);
}

}  // namespace
}  // namespace lcdm::model
