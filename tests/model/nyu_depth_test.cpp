// Reader of NYU Depth V2, against a small set in its published layout.
#include "model/nyu_depth.h"

#include <array>
#include <gtest/gtest.h>
#include <string>
#include <thread>
#include <vector>

#include "tests/model/data_set_fixture.h"

namespace lcdm::model {
namespace {

// The fixture's formulas: 8 x 6 pixels, three frames; splits.mat trains on frame 2 and tests on 1
// and 3, counted from 1.
int fixture_colour(int x, int y, int colour, int frame) {
  return 8 * y + x + 60 * colour + 20 * frame;
}
float fixture_depth(int x, int y, int frame) {
  return 1 + static_cast<float>(y) + 0.125F * static_cast<float>(x) +
         10 * static_cast<float>(frame);
}

class NyuDepth : public DataSet {
 protected:
  void copy_fixture() {
    for (const char* name : {"nyu_depth_v2_labeled.mat", "splits.mat"}) {
      fs::copy_file(kFixtures / "nyu" / name, root_ / name, fs::copy_options::overwrite_existing);
    }
  }
  void write_folders() {
    const fs::path scene = root_ / "official_splits" / "test" / "home_office";
    write_picture(scene / "rgb_00008.jpg", {8, 6}, {10, 100, 200});
    cv::Mat_<std::uint16_t> depth = no_depth(6, 8);
    depth(1, 2) = 2345;
    write_depth(scene / "sync_depth_00008.png", depth);
  }
};

TEST_F(NyuDepth, TheLabelledFileIsReadInMatlabsOrder) {
  const FramesResult frames = open_nyu_depth((kFixtures / "nyu").string());
  ASSERT_TRUE(frames) << frames.status().text();
  ASSERT_EQ((*frames)->size(), 2U);
  EXPECT_EQ((*frames)->name(0), "rgb_00000");
  EXPECT_EQ((*frames)->name(1), "rgb_00002");
  const Result<PackFrame> frame = (*frames)->read(1);
  ASSERT_TRUE(frame) << frame.status().text();
  ASSERT_EQ(frame->rgb.size(), cv::Size(8, 6));
  ASSERT_EQ(frame->depth.size(), cv::Size(8, 6));
  for (int y = 0; y < 6; ++y) {
    for (int x = 0; x < 8; ++x) {
      const bool hole = y == 2 && (x == 3 || x == 4);  // 0 and NaN in the file
      EXPECT_FLOAT_EQ(frame->depth.at<float>(y, x), hole ? 0 : fixture_depth(x, y, 2));
      for (int c = 0; c < 3; ++c) {
        EXPECT_EQ(frame->rgb.at<cv::Vec3b>(y, x)[c], fixture_colour(x, y, c, 2));
      }
    }
  }
}

TEST_F(NyuDepth, TheCameraIsThatOfTheAuthorsToolbox) {
  const FramesResult frames = open_nyu_depth((kFixtures / "nyu").string());
  ASSERT_TRUE(frames) << frames.status().text();
  const CameraModel camera = (*frames)->read(0)->camera;  // of 8 x 6 instead of 640 x 480
  EXPECT_NEAR(camera.fx, 518.8579 / 80, 1e-4);
  EXPECT_NEAR(camera.fy, 519.4696 / 80, 1e-4);
  EXPECT_NEAR(camera.cx, (324.5824 + 0.5) / 80 - 0.5, 1e-4);
  EXPECT_NEAR(camera.cy, (252.7362 + 0.5) / 80 - 0.5, 1e-4);
  EXPECT_TRUE(camera.calibrated);
}

TEST_F(NyuDepth, TheTrainingSplitIsThereToo) {
  NyuDepthOptions options;
  options.split = NyuDepthOptions::Split::kTrain;
  const FramesResult frames = open_nyu_depth((kFixtures / "nyu").string(), options);
  ASSERT_TRUE(frames) << frames.status().text();
  ASSERT_EQ((*frames)->size(), 1U);
  const Result<PackFrame> frame = (*frames)->read(0);
  ASSERT_TRUE(frame) << frame.status().text();
  EXPECT_FLOAT_EQ(frame->depth.at<float>(1, 1), fixture_depth(1, 1, 1));
}

TEST_F(NyuDepth, ReducedFramesKeepTheirHoles) {
  NyuDepthOptions options;
  options.max_width = 4;
  const FramesResult frames = open_nyu_depth((kFixtures / "nyu").string(), options);
  ASSERT_TRUE(frames) << frames.status().text();
  const Result<PackFrame> frame = (*frames)->read(0);
  ASSERT_TRUE(frame) << frame.status().text();
  EXPECT_EQ(frame->rgb.size(), cv::Size(4, 3));
  EXPECT_FLOAT_EQ(frame->depth.at<float>(1, 1), fixture_depth(2, 2, 0));  // nearest, not a mean
  EXPECT_FLOAT_EQ(frame->depth.at<float>(1, 2), 0);
  EXPECT_NEAR(frame->camera.fx, 518.8579 / 160, 1e-4);
}

TEST_F(NyuDepth, LabelledPicturesHaveNoNeighbours) {
  const FramesResult frames = open_nyu_depth((kFixtures / "nyu").string());
  ASSERT_TRUE(frames);
  EXPECT_FALSE((*frames)->has_neighbours(1));
  EXPECT_EQ((*frames)->neighbour(1, -1).code(), StatusCode::kNotFound);
}

TEST_F(NyuDepth, ManyThreadsMayRead) {
  const FramesResult frames = open_nyu_depth((kFixtures / "nyu").string());
  ASSERT_TRUE(frames);
  std::vector<std::thread> threads;
  std::array<int, 4> good{};
  for (std::size_t t = 0; t < good.size(); ++t) {
    threads.emplace_back([&, t] {
      for (int i = 0; i < 20; ++i) {
        const FramesResult own = open_nyu_depth((kFixtures / "nyu").string());
        good[t] += (*frames)->read(t % 2)->rgb.at<cv::Vec3b>(0, 0)[0] == 40 * (t % 2);
        good[t] += own && (*own)->read(0);
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  for (const int count : good) EXPECT_EQ(count, 40);
}

TEST_F(NyuDepth, BrokenMatlabFilesAreNamed) {
  copy_fixture();
  const auto error = [&] { return std::string(open_nyu_depth(root_.string()).status().text()); };
  const auto code = [&] { return open_nyu_depth(root_.string()).code(); };
  cut(root_ / "nyu_depth_v2_labeled.mat");
  EXPECT_EQ(code(), StatusCode::kCorrupt);
  EXPECT_NE(error().find("nyu_depth_v2_labeled.mat"), std::string::npos) << error();
  write(root_ / "nyu_depth_v2_labeled.mat", "no such format");
  EXPECT_EQ(code(), StatusCode::kCorrupt);
  fs::copy_file(kFixtures / "nyu" / "splits.mat", root_ / "nyu_depth_v2_labeled.mat",
                fs::copy_options::overwrite_existing);
  EXPECT_EQ(code(), StatusCode::kCorrupt);
  EXPECT_NE(error().find("images"), std::string::npos) << error();
  copy_fixture();
  cut(root_ / "splits.mat");
  EXPECT_EQ(code(), StatusCode::kCorrupt);
  EXPECT_NE(error().find("splits.mat"), std::string::npos) << error();
  fs::remove(root_ / "splits.mat");
  EXPECT_EQ(code(), StatusCode::kNotFound);
}

TEST_F(NyuDepth, SplitsThatNameOtherFramesAreRefused) {
  copy_fixture();
  std::string bytes = bytes_of(root_ / "splits.mat");
  const std::size_t at = bytes.rfind('\3');  // the last number, frame 3
  ASSERT_NE(at, std::string::npos);
  for (const char frame : {'\0', '\4', '\x7f'}) {
    bytes[at] = frame;
    write(root_ / "splits.mat", bytes);
    EXPECT_EQ(open_nyu_depth(root_.string()).code(), StatusCode::kCorrupt);
  }
}

TEST_F(NyuDepth, TheFolderFormIsReadInMillimetres) {
  write_folders();
  for (const fs::path& root : {root_, root_ / "official_splits"}) {
    const FramesResult frames = open_nyu_depth(root.string());
    ASSERT_TRUE(frames) << frames.status().text();
    ASSERT_EQ((*frames)->size(), 1U);
    EXPECT_EQ((*frames)->name(0), "home_office/rgb_00008");
    const Result<PackFrame> frame = (*frames)->read(0);
    ASSERT_TRUE(frame) << frame.status().text();
    expect_depth(frame->depth, {{{2, 1}, 2.345F}});
    EXPECT_NEAR(frame->rgb.at<cv::Vec3b>(3, 3)[2], 200, 6);
    EXPECT_FALSE((*frames)->has_neighbours(0));
  }
}

TEST_F(NyuDepth, BrokenFoldersAreNamed) {
  EXPECT_EQ(open_nyu_depth(root_.string()).code(), StatusCode::kNotFound);
  fs::create_directories(root_ / "official_splits" / "test" / "study");
  EXPECT_EQ(open_nyu_depth(root_.string()).code(), StatusCode::kNotFound);
  write_folders();
  const FramesResult frames = open_nyu_depth(root_.string());
  ASSERT_TRUE(frames) << frames.status().text();
  const fs::path scene = root_ / "official_splits" / "test" / "home_office";
  cut(scene / "sync_depth_00008.png");
  EXPECT_EQ((*frames)->read(0).code(), StatusCode::kCorrupt);
  write_depth(scene / "sync_depth_00008.png", no_depth(3, 4));
  EXPECT_EQ((*frames)->read(0).code(), StatusCode::kCorrupt);
  fs::remove(scene / "sync_depth_00008.png");
  EXPECT_EQ((*frames)->read(0).code(), StatusCode::kNotFound);
  write_picture(scene / "rgb_00008.jpg", {9, 6}, {1, 2, 3});
  write_depth(scene / "sync_depth_00008.png", no_depth(6, 9));
  EXPECT_EQ((*frames)->read(0).code(), StatusCode::kCorrupt);
  cut(scene / "rgb_00008.jpg");
  EXPECT_EQ((*frames)->read(0).code(), StatusCode::kCorrupt);
}

}  // namespace
}  // namespace lcdm::model
