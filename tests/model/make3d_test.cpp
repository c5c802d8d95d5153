// Reader of Make3D, against a small set in its published layout.
#include "model/make3d.h"

#include <gtest/gtest.h>
#include <random>
#include <string>

#include "tests/model/data_set_fixture.h"

namespace lcdm::model {
namespace {

// Fixtures: depth 1 + row, and 100 m more in the right half. op1: 55 x 305, compressed, as the
// published grids; op2: 4 rows x 6 columns, not compressed.
class Make3d : public DataSet {
 protected:
  void SetUp() override {
    for (const char* name : {"op1-p-015t000", "op2-p-200t000"}) {
      write_picture(root_ / "Test134" / ("img-" + std::string(name) + ".jpg"), {24, 32},
                    {10, 100, 200});
      const std::string grid = "depth_sph_corr-" + std::string(name) + ".mat";
      fs::create_directories(root_ / "Gridlaserdata");
      fs::copy_file(kFixtures / "make3d" / grid, root_ / "Gridlaserdata" / grid);
    }
  }
  fs::path grid(const char* name) {
    return root_ / "Gridlaserdata" / ("depth_sph_corr-" + std::string(name) + ".mat");
  }
};

TEST_F(Make3d, TheMiddleOfThePictureHasTheScannersGridSpreadOverTheWhole) {
  const FramesResult frames = open_make3d(root_.string());
  ASSERT_TRUE(frames) << frames.status().text();
  ASSERT_EQ((*frames)->size(), 2U);
  EXPECT_EQ((*frames)->name(1), "op2-p-200t000");
  const Result<PackFrame> frame = (*frames)->read(1);
  ASSERT_TRUE(frame) << frame.status().text();
  ASSERT_EQ(frame->rgb.size(), cv::Size(24, 12));
  ASSERT_EQ(frame->depth.size(), cv::Size(24, 12));
  EXPECT_NEAR(frame->rgb.at<cv::Vec3b>(9, 9)[2], 200, 6);
  for (int y = 0; y < 12; ++y) {  // 4 x 6 cells of 8 rows x 4 columns; of 32 rows the middle 12
    for (int x = 0; x < 24; ++x) {
      EXPECT_FLOAT_EQ(frame->depth.at<float>(y, x),
                      1 + static_cast<float>((y + 10) / 8) + (x >= 12 ? 100.F : 0.F));
    }
  }
  EXPECT_FLOAT_EQ(frame->camera.cy, 5.5F);
  EXPECT_EQ(frame->camera.height, 12);
}

TEST_F(Make3d, GridsOfThePublishedSizeAreRead) {
  const FramesResult frames = open_make3d(root_.string());
  ASSERT_TRUE(frames) << frames.status().text();
  const Result<PackFrame> frame = (*frames)->read(0);
  ASSERT_TRUE(frame) << frame.status().text();
  // By the middles of the picture's rows 10 and 21.
  EXPECT_FLOAT_EQ(frame->depth.at<float>(0, 0), 1 + 21 * 55 / 64);
  EXPECT_FLOAT_EQ(frame->depth.at<float>(11, 0), 1 + 43 * 55 / 64);
  EXPECT_FLOAT_EQ(frame->depth.at<float>(11, 23), 101 + 43 * 55 / 64);
}

TEST_F(Make3d, TheCameraIsAssumedAndFollowsTheLongerSide) {
  Make3dOptions options;
  options.max_width = 12;
  const FramesResult frames = open_make3d(root_.string(), options);
  ASSERT_TRUE(frames) << frames.status().text();
  const Result<PackFrame> frame = (*frames)->read(0);
  ASSERT_TRUE(frame) << frame.status().text();
  EXPECT_EQ(frame->depth.size(), cv::Size(12, 6));  // the middle of 12 x 16
  EXPECT_FALSE(frame->camera.calibrated);
  EXPECT_NEAR(frame->camera.fx, 2403.8 * 16 / 2272, 0.01);
  EXPECT_FLOAT_EQ(frame->camera.cy, 2.5F);
  EXPECT_FALSE((*frames)->has_neighbours(0));
  EXPECT_EQ((*frames)->neighbour(0, 1).code(), StatusCode::kNotFound);
}

TEST_F(Make3d, MissingFilesAreNamed) {
  const FramesResult frames = open_make3d(root_.string());
  ASSERT_TRUE(frames) << frames.status().text();
  fs::remove(grid("op1-p-015t000"));
  EXPECT_EQ((*frames)->read(0).code(), StatusCode::kNotFound);
  EXPECT_TRUE(open_make3d(root_.string()));
  fs::remove_all(root_ / "Gridlaserdata");
  EXPECT_EQ(open_make3d(root_.string()).code(), StatusCode::kNotFound);
  fs::remove_all(root_ / "Test134");
  EXPECT_EQ(open_make3d(root_.string()).code(), StatusCode::kNotFound);
}

TEST_F(Make3d, BrokenFilesAreNamed) {
  const FramesResult frames = open_make3d(root_.string());
  ASSERT_TRUE(frames) << frames.status().text();
  for (const std::size_t index : {0U, 1U}) {
    const fs::path file = grid((*frames)->name(index).c_str());
    cut(file);
    EXPECT_EQ((*frames)->read(index).code(), StatusCode::kCorrupt);
    EXPECT_NE(std::string((*frames)->read(index).status().text()).find("depth_sph_corr"),
              std::string::npos);
    fs::copy_file(kFixtures / "nyu" / "splits.mat", file, fs::copy_options::overwrite_existing);
    EXPECT_EQ((*frames)->read(index).code(), StatusCode::kCorrupt);
  }
  cut(root_ / "Test134" / "img-op1-p-015t000.jpg");
  EXPECT_EQ((*frames)->read(0).code(), StatusCode::kCorrupt);
}

TEST_F(Make3d, NoBytesOfAGridCanDoHarm) {
  const FramesResult frames = open_make3d(root_.string());
  ASSERT_TRUE(frames) << frames.status().text();
  std::mt19937 random(1);
  for (const std::size_t index : {0U, 1U}) {
    const fs::path file = grid((*frames)->name(index).c_str());
    const std::string good = bytes_of(file);
    for (int round = 0; round < 100; ++round) {
      std::string bad = good;
      for (int i = 0; i < 1 + round % 8; ++i) {
        bad[random() % bad.size()] = static_cast<char>(random());
      }
      write(file, bad);
      const Result<PackFrame> frame = (*frames)->read(index);
      EXPECT_TRUE(!frame || frame->depth.size() == cv::Size(24, 12));
    }
  }
}

}  // namespace
}  // namespace lcdm::model
