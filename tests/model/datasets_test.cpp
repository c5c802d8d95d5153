// Readers of published data sets, each against a small one written in its published layout.
#include <array>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>
#include <limits>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "model/dataset_files.h"
#include "model/kitti_raw.h"
#include "model/make3d.h"
#include "model/nyu_depth.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;
using FramesResult = Result<std::shared_ptr<const Frames>>;

const fs::path kFixtures = "tests/fixtures/datasets";  // see its README.md

cv::Mat_<std::uint16_t> no_depth(int rows, int columns) {
  return cv::Mat_<std::uint16_t>(rows, columns, std::uint16_t{0});
}

// An empty folder of the test's own, removed behind it.
class DataSet : public testing::Test {
 protected:
  void SetUp() override {
    const auto* test = testing::UnitTest::GetInstance()->current_test_info();
    root_ = fs::path(testing::TempDir()) /
            (std::string("lcdm-") + test->test_suite_name() + "-" + test->name());
    fs::remove_all(root_);
    fs::create_directories(root_);
  }
  void TearDown() override { fs::remove_all(root_); }

  static void write(const fs::path& file, const std::string& bytes) {
    fs::create_directories(file.parent_path());
    std::ofstream(file, std::ios::binary) << bytes;
  }
  static std::string bytes_of(const fs::path& file) {
    std::ifstream stream(file, std::ios::binary);
    return {std::istreambuf_iterator<char>(stream), {}};
  }
  static void cut(const fs::path& file) { fs::resize_file(file, fs::file_size(file) * 2 / 3); }
  // One colour.
  static void write_picture(const fs::path& file, cv::Size size, cv::Vec3b rgb) {
    fs::create_directories(file.parent_path());
    cv::imwrite(file.string(), cv::Mat(size, CV_8UC3, cv::Scalar(rgb[2], rgb[1], rgb[0])));
  }
  static void write_depth(const fs::path& file, const cv::Mat_<std::uint16_t>& depth) {
    fs::create_directories(file.parent_path());
    cv::imwrite(file.string(), depth);
  }

  fs::path root_;
};

// Every pixel but these is 0.
void expect_depth(const cv::Mat& depth, const std::map<std::array<int, 2>, float>& points) {
  for (int y = 0; y < depth.rows; ++y) {
    for (int x = 0; x < depth.cols; ++x) {
      const auto found = points.find({x, y});
      EXPECT_FLOAT_EQ(depth.at<float>(y, x), found == points.end() ? 0 : found->second)
          << "at x " << x << ", y " << y;
    }
  }
}

// ---- KITTI raw ----------------------------------------------------------------------------------

constexpr const char* kDate = "2011_09_26";
constexpr const char* kDrive = "2011_09_26_drive_0002_sync";

// Two drives of pictures of 10 x 6. The scanner stands 1 m behind the cameras and looks the same
// way: (forward, left, up) is (-left, -up, forward - 1) to the camera. Focal length 4, centre
// (5, 3); the right camera is 2 m to the right.
class KittiRaw : public DataSet {
 protected:
  void SetUp() override {
    DataSet::SetUp();
    options_.root = (root_ / "raw").string();
    options_.list = (root_ / "list.txt").string();
    date_ = root_ / "raw" / kDate;
    drive_ = date_ / kDrive;
    write_cameras();
    write(date_ / "calib_velo_to_cam.txt",
          "calib_time: 15-Mar-2012 11:37:16\n"
          "R: 0.000000e+00 -1.000000e+00 0 0 0 -1 1 0 0\n"
          "T: 0 0 -1.000000e+00\n"
          "delta_f: 0.000000e+00 0.000000e+00\n");
    for (int i = 4; i <= 6; ++i) write_picture(picture(i), {10, 6}, {10, 100, 200});
    list("2011_09_26/2011_09_26_drive_0002_sync 5 l\n");
  }

  void write_cameras(const std::string& rectification = "1 0 0 0 1 0 0 0 1") {
    write(date_ / "calib_cam_to_cam.txt",
          "calib_time: 09-Jan-2012 13:57:47\n"
          "corner_dist: 9.950000e-02\n"
          "S_rect_00: 9 9\n"
          "R_rect_00: " +
              rectification +
              "\n"
              "S_rect_02: 1.000000e+01 6.000000e+00\n"
              "R_rect_02: 9 9 9 9 9 9 9 9 9\n"
              "P_rect_02: 4.000000e+00 0 5 0 0 4 3 0 0 0 1 0\n"
              "S_rect_03: 1.000000e+01 6.000000e+00\n"
              "P_rect_03: 4 0 5 -8 0 4 3 0 0 0 1 0\n");
  }
  void list(const std::string& lines) { write(options_.list, lines); }
  fs::path picture(int number, const char* extension = ".png", const char* camera = "image_02") {
    return drive_ / camera / "data" / ("000000000" + std::to_string(number) + extension);
  }
  using Point = std::array<float, 4>;  // forward, left, up, reflectance
  void sweep(const std::vector<Point>& points) {
    std::string bytes(points.size() * 16, '\0');
    std::memcpy(bytes.data(), points.data(), bytes.size());
    write(drive_ / "velodyne_points" / "data" / "0000000005.bin", bytes);
    options_.depth = KittiRawOptions::Depth::kVelodyne;
  }

  // The only listed frame.
  Result<PackFrame> read() {
    const FramesResult frames = open_kitti_raw(options_);
    if (!frames) return frames.status();
    return (*frames)->read(0);
  }
  StatusCode code() { return read().code(); }
  std::string error() {
    const Result<PackFrame> frame = read();
    return frame ? "no error" : frame.status().text();
  }

  fs::path date_;
  fs::path drive_;
  KittiRawOptions options_;
};

TEST_F(KittiRaw, ReadsAPictureWithItsCamera) {
  const Result<PackFrame> frame = read();
  ASSERT_TRUE(frame) << frame.status().text();
  EXPECT_EQ(frame->name, "2011_09_26_drive_0002_sync/image_02/0000000005");
  EXPECT_EQ(frame->rgb.size(), cv::Size(10, 6));
  EXPECT_EQ(frame->rgb.at<cv::Vec3b>(2, 2), cv::Vec3b(10, 100, 200));  // red first
  EXPECT_EQ(frame->camera.width, 10);
  EXPECT_EQ(frame->camera.height, 6);
  EXPECT_FLOAT_EQ(frame->camera.fx, 4);
  EXPECT_FLOAT_EQ(frame->camera.fy, 4);
  EXPECT_FLOAT_EQ(frame->camera.cx, 5);
  EXPECT_FLOAT_EQ(frame->camera.cy, 3);
  EXPECT_TRUE(frame->camera.calibrated);
  EXPECT_EQ(frame->depth.type(), CV_32F);
  expect_depth(frame->depth, {});
}

TEST_F(KittiRaw, ReadsPicturesConvertedToJpeg) {
  fs::remove(picture(5));
  write_picture(picture(5, ".jpg"), {10, 6}, {10, 100, 200});
  const Result<PackFrame> frame = read();
  ASSERT_TRUE(frame) << frame.status().text();
  EXPECT_NEAR(frame->rgb.at<cv::Vec3b>(2, 2)[2], 200, 6);
}

TEST_F(KittiRaw, ListsMayNameBothCamerasPadNumbersAndEndInCrLf) {
  write_picture(picture(7, ".png", "image_03"), {10, 6}, {1, 2, 3});
  list(
      "2011_09_26/2011_09_26_drive_0002_sync 0000000005 l\r\n\r\n"
      "2011_09_26/2011_09_26_drive_0002_sync 7 r\r\n");
  const FramesResult frames = open_kitti_raw(options_);
  ASSERT_TRUE(frames) << frames.status().text();
  ASSERT_EQ((*frames)->size(), 2U);
  EXPECT_EQ((*frames)->name(1), "2011_09_26_drive_0002_sync/image_03/0000000007");
  EXPECT_TRUE((*frames)->read(0));
  EXPECT_EQ((*frames)->read(1)->rgb.at<cv::Vec3b>(0, 0), cv::Vec3b(1, 2, 3));
}

TEST_F(KittiRaw, PointsLandInThePixelWorkedOutByHand) {
  sweep({{5, 0, 0, 0},     // camera (0, 0, 4): projected to (5, 3), minus 1: pixel (4, 2)
         {9, 2, 1, 0},     // (-2, -1, 8): (4, 2.5); half to even: 2; pixel (3, 1)
         {9, 0, -1, 0},    // (0, 1, 8): (5, 3.5), to 4: pixel (4, 3)
         {5, -5, 0, 0}});  // (5, 0, 4): (10, 3): the last column
  const Result<PackFrame> frame = read();
  ASSERT_TRUE(frame) << frame.status().text();
  expect_depth(frame->depth, {{{4, 2}, 5.F}, {{3, 1}, 9.F}, {{4, 3}, 9.F}, {{9, 2}, 5.F}});
}

TEST_F(KittiRaw, DepthIsTheScannersUnlessTheOpticalAxisIsAskedFor) {
  sweep({{5, 0, 0, 0}, {9, 2, 1, 0}});
  options_.scanner_depth = false;
  expect_depth(read()->depth, {{{4, 2}, 4.F}, {{3, 1}, 8.F}});
}

TEST_F(KittiRaw, TheNearestPointOfAPixelWinsInAnyOrder) {
  sweep({{13, 0, 0, 0}, {5, 0, 0, 0}, {21, 0, 0, 0}});
  expect_depth(read()->depth, {{{4, 2}, 5.F}});
}

TEST_F(KittiRaw, PointsBehindOutsideOrNotFiniteAreLeftOut) {
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  constexpr float kHuge = std::numeric_limits<float>::max();
  sweep({{-3, 2, 0, 0},       // behind the scanner; by arithmetic alone pixel (6, 2)
         {0.5F, 0.5F, 0, 0},  // before it, behind the camera; by arithmetic alone (8, 2)
         {1, 0, 0, 0},        // in the camera's plane
         {5, 5, 0, 0},        // (-5, 0, 4): column 0 - 1
         {5, -6, 0, 0},       // column 11 - 1 of 10
         {5, 0, 3, 0},        // row 0 - 1
         {5, 0, -4, 0},       // row 7 - 1 of 6
         {kNan, 0, 0, 0},
         {5, kNan, 0, 0},
         {5, 0, kHuge, 0},
         {kHuge, kHuge, kHuge, 0}});
  const Result<PackFrame> frame = read();
  ASSERT_TRUE(frame) << frame.status().text();
  expect_depth(frame->depth, {});
}

TEST_F(KittiRaw, TheReferenceCamerasRectificationComesBeforeTheProjection) {
  write_cameras("0 1 0 -1 0 0 0 0 1");
  sweep({{9, 2, 1, 0}});  // camera (-2, -1, 8), rectified (-1, 2, 8): (4.5, 4), pixel (3, 3)
  expect_depth(read()->depth, {{{3, 3}, 9.F}});
}

TEST_F(KittiRaw, TheRightCameraHasItsOwnProjection) {
  write_picture(picture(5, ".png", "image_03"), {10, 6}, {1, 2, 3});
  list("2011_09_26/2011_09_26_drive_0002_sync 5 r\n");
  sweep({{5, 0, 0, 0}});  // (0 * 4 + 5 * 4 - 8) / 4 = 3: pixel (2, 2)
  expect_depth(read()->depth, {{{2, 2}, 5.F}});
}

TEST_F(KittiRaw, AReducedPictureKeepsTheNearestPointOfEachPixel) {
  options_.max_width = 5;
  sweep({{9, -2, -2, 0},  // (2, 2, 8): (6, 4), pixel (5, 3), reduced (2, 1)
         {5, 0, 0, 0},    // pixel (4, 2), reduced (2, 1) too
         {9, 2, 1, 0}});  // pixel (3, 1), reduced (1, 0)
  const Result<PackFrame> frame = read();
  ASSERT_TRUE(frame) << frame.status().text();
  EXPECT_EQ(frame->rgb.size(), cv::Size(5, 3));
  EXPECT_EQ(frame->depth.size(), cv::Size(5, 3));
  expect_depth(frame->depth, {{{2, 1}, 5.F}, {{1, 0}, 9.F}});
  EXPECT_EQ(frame->camera.width, 5);
  EXPECT_FLOAT_EQ(frame->camera.fx, 2);
  EXPECT_FLOAT_EQ(frame->camera.cx, (5 + 0.5F) / 2 - 0.5F);
}

TEST_F(KittiRaw, BrokenSweepsAreNamed) {
  sweep({{5, 0, 0, 0}, {9, 2, 1, 0}});
  const fs::path file = drive_ / "velodyne_points" / "data" / "0000000005.bin";
  fs::resize_file(file, 17);
  EXPECT_EQ(code(), StatusCode::kCorrupt);
  EXPECT_NE(error().find("0000000005.bin"), std::string::npos) << error();
  fs::resize_file(file, 0);
  EXPECT_EQ(code(), StatusCode::kCorrupt);
  fs::remove(file);
  EXPECT_EQ(code(), StatusCode::kNotFound);
}

TEST_F(KittiRaw, NeighboursAreThoseOfTheDriveListedOrNot) {
  write_picture(picture(4), {10, 6}, {4, 4, 4});
  fs::remove(picture(6));
  write_picture(picture(6, ".jpg"), {10, 6}, {60, 60, 60});
  list(
      "2011_09_26/2011_09_26_drive_0002_sync 5 l\n"
      "2011_09_26/2011_09_26_drive_0002_sync 4 l\n"
      "2011_09_26/2011_09_26_drive_0002_sync 5 r\n");
  options_.max_width = 5;
  const FramesResult frames = open_kitti_raw(options_);
  ASSERT_TRUE(frames) << frames.status().text();
  ASSERT_TRUE((*frames)->has_neighbours(0));
  EXPECT_EQ((*frames)->neighbour(0, -1)->at<cv::Vec3b>(0, 0)[0], 4);
  EXPECT_NEAR((*frames)->neighbour(0, 1)->at<cv::Vec3b>(0, 0)[0], 60, 3);
  EXPECT_EQ((*frames)->neighbour(0, 1)->size(), (*frames)->read(0)->rgb.size());
  EXPECT_FALSE((*frames)->has_neighbours(1));
  EXPECT_EQ((*frames)->neighbour(1, -1).code(), StatusCode::kNotFound);
  EXPECT_FALSE((*frames)->has_neighbours(2));  // the other camera's do not count
}

TEST_F(KittiRaw, MissingPicturesAreCountedAndFailWhenRead) {
  list(
      "2011_09_26/2011_09_26_drive_0002_sync 5 l\n"
      "2011_09_26/2011_09_26_drive_0002_sync 77 l\n"
      "2011_09_26/2011_09_26_drive_0009_sync 1 r\n");
  std::size_t missing = 0;
  const FramesResult frames = open_kitti_raw(options_, &missing);
  ASSERT_TRUE(frames) << frames.status().text();
  EXPECT_EQ(missing, 2U);
  EXPECT_TRUE((*frames)->read(0));
  EXPECT_EQ((*frames)->read(1).code(), StatusCode::kNotFound);
  EXPECT_NE(std::string((*frames)->read(1).status().text()).find("0000000077"), std::string::npos);
  EXPECT_EQ((*frames)->read(2).code(), StatusCode::kNotFound);
}

TEST_F(KittiRaw, NoPictureAtAllFailsAtOnce) {
  fs::remove_all(drive_);
  EXPECT_EQ(open_kitti_raw(options_).code(), StatusCode::kNotFound);
}

TEST_F(KittiRaw, MalformedLinesAreNamedWithTheirNumber) {
  for (const char* line :
       {"2011_09_26_drive_0002_sync 5 l", "2011_09_26/2011_09_26_drive_0002_sync 5",
        "2011_09_26/2011_09_26_drive_0002_sync 5 x", "2011_09_26/2011_09_26_drive_0002_sync 5 l l",
        "2011_09_26/2011_09_26_drive_0002_sync -5 l", "2011_09_26/2011_09_26_drive_0002_sync 5a l",
        "2011_09_26/2011_09_26_drive_0002_sync 12345678901 l",
        "2011_09_28/2011_09_26_drive_0002_sync 5 l", "../2011_09_26_drive_0002_sync 5 l",
        "2011_09_26/2011_09_26_drive_0002_extract 5 l", "2011_09_26/../../../../etc 5 l"}) {
    list(std::string("2011_09_26/2011_09_26_drive_0002_sync 5 l\n\n") + line + "\n");
    EXPECT_EQ(code(), StatusCode::kCorrupt) << line;
    EXPECT_NE(error().find("list.txt:3:"), std::string::npos) << error();
  }
}

TEST_F(KittiRaw, AListMustExistAndNameAFrame) {
  list("\n\n");
  EXPECT_EQ(code(), StatusCode::kCorrupt);
  list("");
  EXPECT_EQ(code(), StatusCode::kCorrupt);
  fs::remove(options_.list);
  EXPECT_EQ(code(), StatusCode::kNotFound);
  EXPECT_NE(error().find("list.txt"), std::string::npos);
}

TEST_F(KittiRaw, FoldersMustExist) {
  options_.depth = KittiRawOptions::Depth::kImproved;
  options_.depth_root = (root_ / "nowhere").string();
  EXPECT_NE(error().find("nowhere"), std::string::npos);
  EXPECT_EQ(code(), StatusCode::kNotFound);
  options_.root = (root_ / "elsewhere").string();
  EXPECT_NE(error().find("elsewhere"), std::string::npos);
  EXPECT_EQ(code(), StatusCode::kNotFound);
}

TEST_F(KittiRaw, BrokenPicturesAreNamed) {
  cut(picture(5));
  EXPECT_EQ(code(), StatusCode::kCorrupt);
  EXPECT_NE(error().find("0000000005.png"), std::string::npos) << error();
  write(picture(5), "");
  EXPECT_EQ(code(), StatusCode::kCorrupt);
  write(picture(5), "P6 10 6 255 no format of ours");
  EXPECT_EQ(code(), StatusCode::kCorrupt);
  fs::remove(picture(5));
  write_picture(picture(5, ".jpg"), {10, 6}, {10, 100, 200});
  cut(picture(5, ".jpg"));  // decoders fill the rest with grey
  EXPECT_EQ(code(), StatusCode::kCorrupt);
  EXPECT_NE(error().find("0000000005.jpg"), std::string::npos) << error();
}

TEST_F(KittiRaw, APictureOfAnotherSizeThanItsCalibrationIsRefused) {
  write_picture(picture(5), {8, 6}, {1, 2, 3});
  EXPECT_EQ(code(), StatusCode::kCorrupt);
  EXPECT_NE(error().find("8x6"), std::string::npos) << error();
}

TEST_F(KittiRaw, WrongCalibrationsAreNamed) {
  const fs::path file = date_ / "calib_cam_to_cam.txt";
  const std::string good = bytes_of(file);
  const auto replaced = [&good](const std::string& from, const std::string& to) {
    std::string text = good;
    return text.replace(text.find(from), from.size(), to);
  };
  for (const std::string& bad :
       {replaced("P_rect_03", "P_rect_33"), replaced("P_rect_02: 4.0", "P_rect_02: -4.0"),
        replaced("P_rect_02: 4.0", "P_rect_02: nan 4.0"), replaced("0 4 3 0 0 0 1 0", "0 4 3 0 0"),
        replaced("S_rect_02: 1.00", "S_rect_02: 1.05"), replaced("S_rect_02: 1.", "S_rect_02: -1."),
        replaced("e+01 6.0", "e+09 6.0"), replaced("1.000000e+01", "ten"),
        std::string("\0\1\2\3", 4), std::string()}) {
    write(file, bad);
    EXPECT_EQ(open_kitti_raw(options_).code(), StatusCode::kCorrupt) << bad;
    EXPECT_NE(error().find("calib_cam_to_cam.txt"), std::string::npos) << error();
  }
  fs::remove(file);
  EXPECT_EQ(open_kitti_raw(options_).code(), StatusCode::kNotFound);
}

TEST_F(KittiRaw, TheScannersCalibrationMattersForItsPointsOnly) {
  const fs::path file = date_ / "calib_velo_to_cam.txt";
  write(file, "R: 1 0 0\n");
  EXPECT_TRUE(read());
  sweep({{5, 0, 0, 0}});
  EXPECT_EQ(code(), StatusCode::kCorrupt);
  EXPECT_NE(error().find("calib_velo_to_cam.txt"), std::string::npos) << error();
  fs::remove(file);
  EXPECT_EQ(code(), StatusCode::kNotFound);
}

TEST_F(KittiRaw, ImprovedGroundTruthIsFoundBelowItsFolderTrainOrVal) {
  options_.depth = KittiRawOptions::Depth::kImproved;
  options_.depth_root = (root_ / "annotated").string();
  fs::create_directories(options_.depth_root);
  EXPECT_EQ(code(), StatusCode::kNotFound);
  cv::Mat_<std::uint16_t> depth = no_depth(6, 10);
  depth(2, 4) = 256 * 7 + 128;
  depth(3, 5) = 256 * 2;
  for (const char* place : {"", "train", "val"}) {
    const fs::path file = fs::path(options_.depth_root) / place / kDrive / "proj_depth" /
                          "groundtruth" / "image_02" / "0000000005.png";
    write_depth(file, depth);
    options_.max_width = 10;
    EXPECT_EQ(code(), StatusCode::kOk) << error();
    expect_depth(read()->depth, {{{4, 2}, 7.5F}, {{5, 3}, 2.F}});
    options_.max_width = 5;
    expect_depth(read()->depth, {{{2, 1}, 2.F}});
    cut(file);
    EXPECT_EQ(code(), StatusCode::kCorrupt);
    write_depth(file, no_depth(6, 9));
    EXPECT_EQ(code(), StatusCode::kCorrupt);
    cv::imwrite(file.string(), cv::Mat(cv::Mat::zeros(6, 10, CV_8U)));
    EXPECT_EQ(code(), StatusCode::kUnsupported);
    fs::remove(file);
  }
}

TEST_F(KittiRaw, TeachersMapsMayHaveAnySizeAndAreResizedAsInverse) {
  options_.depth = KittiRawOptions::Depth::kMaps;
  options_.depth_root = (root_ / "maps").string();
  const fs::path file = root_ / "maps" / kDrive / "image_02" / "0000000005.png";
  cv::Mat_<std::uint16_t> map(1, 2);
  map << 256 * 2, 256 * 6;
  write_depth(file, map);
  const Result<PackFrame> frame = read();
  ASSERT_TRUE(frame) << frame.status().text();
  EXPECT_EQ(frame->depth.size(), cv::Size(10, 6));
  EXPECT_FLOAT_EQ(frame->depth.at<float>(3, 0), 2);
  EXPECT_FLOAT_EQ(frame->depth.at<float>(3, 9), 6);
  // Column 4 lies at (4.5 / 5) - .5 = .4 of the way.
  EXPECT_NEAR(frame->depth.at<float>(3, 4), 1 / (0.6 / 2 + 0.4 / 6), 1e-4);
  fs::remove(file);
  EXPECT_EQ(code(), StatusCode::kNotFound);
}

TEST_F(KittiRaw, ThePublishedListsAreUnderstood) {
  const fs::path splits = "../shared/data/splits";
  if (!fs::exists(splits)) GTEST_SKIP() << splits << " is not here";
  for (const auto& [name, count] :
       std::map<std::string, std::size_t>{{"eigen/test_files.txt", 697},
                                          {"eigen_benchmark/test_files.txt", 652},
                                          {"eigen_zhou/train_files.txt", 39810},
                                          {"eigen_zhou/val_files.txt", 4424}}) {
    for (const char* date :
         {"2011_09_26", "2011_09_28", "2011_09_29", "2011_09_30", "2011_10_03"}) {
      write(root_ / "raw" / date / "calib_cam_to_cam.txt",
            bytes_of(date_ / "calib_cam_to_cam.txt"));
    }
    // One picture of each list, so that it opens.
    const std::string text = bytes_of(splits / name);
    options_.list = (splits / name).string();
    const std::string drive = text.substr(0, text.find(' '));
    const std::string rest = text.substr(drive.size() + 1);
    std::string number = rest.substr(0, rest.find(' '));
    number.insert(0, 10 - number.size(), '0');
    const char* camera = rest[rest.find(' ') + 1] == 'l' ? "image_02" : "image_03";
    write_picture(root_ / "raw" / drive / camera / "data" / (number + ".jpg"), {10, 6}, {1, 2, 3});
    std::size_t missing = 0;
    const FramesResult frames = open_kitti_raw(options_, &missing);
    ASSERT_TRUE(frames) << frames.status().text();
    EXPECT_EQ((*frames)->size(), count) << name;
    EXPECT_LT(missing, count) << name;
    EXPECT_TRUE((*frames)->read(0)) << (*frames)->read(0).status().text();
  }
}

// ---- NYU Depth V2 -------------------------------------------------------------------------------

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
  EXPECT_NEAR(camera.cx, (325.5824 + 0.5) / 80 - 0.5, 1e-4);
  EXPECT_NEAR(camera.cy, (253.7362 + 0.5) / 80 - 0.5, 1e-4);
  EXPECT_TRUE(camera.calibrated);
}

TEST_F(NyuDepth, TheTrainingSplitAndPaintedDepthAreThereToo) {
  NyuDepthOptions options;
  options.split = NyuDepthOptions::Split::kTrain;
  options.painted = true;
  const FramesResult frames = open_nyu_depth((kFixtures / "nyu").string(), options);
  ASSERT_TRUE(frames) << frames.status().text();
  ASSERT_EQ((*frames)->size(), 1U);
  const Result<PackFrame> frame = (*frames)->read(0);
  ASSERT_TRUE(frame) << frame.status().text();
  EXPECT_FLOAT_EQ(frame->depth.at<float>(2, 3), fixture_depth(3, 2, 1) + 0.5F);
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
  NyuDepthOptions options;
  options.painted = true;
  EXPECT_EQ(open_nyu_depth(root_.string(), options).code(), StatusCode::kUnsupported);
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

// ---- Make3D -------------------------------------------------------------------------------------

// Fixtures: depth 1 + row, and 100 m more in the right half. op1: 55 x 305, compressed, as the
// published grids; op2: 4 rows x 6 columns, not compressed.
class Make3d : public DataSet {
 protected:
  void SetUp() override {
    DataSet::SetUp();
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

TEST_F(Make3d, TheScannersGridIsSpreadOverThePicture) {
  const FramesResult frames = open_make3d(root_.string());
  ASSERT_TRUE(frames) << frames.status().text();
  ASSERT_EQ((*frames)->size(), 2U);
  EXPECT_EQ((*frames)->name(1), "op2-p-200t000");
  const Result<PackFrame> frame = (*frames)->read(1);
  ASSERT_TRUE(frame) << frame.status().text();
  ASSERT_EQ(frame->rgb.size(), cv::Size(24, 32));
  ASSERT_EQ(frame->depth.size(), cv::Size(24, 32));
  EXPECT_NEAR(frame->rgb.at<cv::Vec3b>(9, 9)[2], 200, 6);
  for (int y = 0; y < 32; ++y) {  // 4 x 6 cells of 8 rows x 4 columns
    for (int x = 0; x < 24; ++x) {
      EXPECT_FLOAT_EQ(frame->depth.at<float>(y, x),
                      1 + static_cast<float>(y / 8) + (x >= 12 ? 100.F : 0.F));
    }
  }
}

// 24 x 32: of the rows the middle 12 stay.
TEST_F(Make3d, TheMiddleIsWhatThePublishedProtocolMeasures) {
  Make3dOptions options;
  options.central = true;
  const FramesResult frames = open_make3d(root_.string(), options);
  ASSERT_TRUE(frames) << frames.status().text();
  const Result<PackFrame> frame = (*frames)->read(1);
  ASSERT_TRUE(frame) << frame.status().text();
  ASSERT_EQ(frame->rgb.size(), cv::Size(24, 12));
  ASSERT_EQ(frame->depth.size(), cv::Size(24, 12));
  EXPECT_FLOAT_EQ(frame->depth.at<float>(0, 0), 1 + 10 / 8);
  EXPECT_FLOAT_EQ(frame->depth.at<float>(11, 0), 1 + 21 / 8);
  EXPECT_FLOAT_EQ(frame->camera.cy, 5.5F);
  EXPECT_EQ(frame->camera.height, 12);
}

TEST_F(Make3d, GridsOfThePublishedSizeAreRead) {
  const FramesResult frames = open_make3d(root_.string());
  ASSERT_TRUE(frames) << frames.status().text();
  const Result<PackFrame> frame = (*frames)->read(0);
  ASSERT_TRUE(frame) << frame.status().text();
  EXPECT_FLOAT_EQ(frame->depth.at<float>(0, 0), 1);
  EXPECT_FLOAT_EQ(frame->depth.at<float>(31, 0), 1 + 31 * 55 / 32);
  EXPECT_FLOAT_EQ(frame->depth.at<float>(31, 23), 101 + 31 * 55 / 32);
}

TEST_F(Make3d, TheCameraIsAssumedAndFollowsTheLongerSide) {
  Make3dOptions options;
  options.max_width = 12;
  const FramesResult frames = open_make3d(root_.string(), options);
  ASSERT_TRUE(frames) << frames.status().text();
  const Result<PackFrame> frame = (*frames)->read(0);
  ASSERT_TRUE(frame) << frame.status().text();
  EXPECT_EQ(frame->depth.size(), cv::Size(12, 16));
  EXPECT_FALSE(frame->camera.calibrated);
  EXPECT_NEAR(frame->camera.fx, 2403.8 * 16 / 2272, 0.01);
  EXPECT_FLOAT_EQ(frame->camera.cy, 7.5F);
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
      EXPECT_TRUE(!frame || frame->depth.size() == cv::Size(24, 32));
    }
  }
}

}  // namespace
}  // namespace lcdm::model
