// Reader of KITTI raw, against a small set in its published layout.
#include "model/kitti_raw.h"

#include <array>
#include <cstring>
#include <gtest/gtest.h>
#include <limits>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "model/data_sets.h"
#include "tests/model/data_set_fixture.h"

namespace lcdm::model {
namespace {

constexpr const char* kDate = "2011_09_26";
constexpr const char* kDrive = "2011_09_26_drive_0002_sync";

// Two drives of pictures of 10 x 6. The scanner stands 1 m behind the cameras and looks the same
// way: (forward, left, up) is (-left, -up, forward - 1) to the camera. Focal length 4, centre
// (5, 3); the right camera is 2 m to the right.
class KittiRaw : public DataSet {
 protected:
  void SetUp() override {
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

// Eigen's split has a list of its own to validate on.
TEST_F(KittiRaw, TrainsOnTheWholeListWhereAnotherValidates) {
  std::string lines;
  for (int i = 0; i < 20; ++i) lines += "2011_09_26/2011_09_26_drive_0002_sync 5 l\n";
  list(lines);
  write(root_ / "val.txt", "2011_09_26/2011_09_26_drive_0002_sync 6 l\n");
  const std::string set = "root = \"" + root_.string() +
                          "\"\n[[train]]\nform = \"kitti-raw\"\npath = \"raw\"\n"
                          "list = \"list.txt\"\nteacher = \"none\"\ntall-share = 1\n";
  DataOptions options;
  options.catalogue = (root_ / "catalogue.toml").string();
  write(options.catalogue, set);
  const Status refused = load_training_data(options).status();
  EXPECT_NE(std::string(refused.text()).find("catalogue.toml:2: kitti-raw trains with a"),
            std::string::npos)
      << refused.text();
  write(options.catalogue, set + "validation-list = \"val.txt\"\n");
  const Result<Data> data = load_training_data(options);
  ASSERT_TRUE(data) << data.status().text();
  const Pack& pack = data->packs[0];
  EXPECT_EQ(pack.train.size(), 20U);
  ASSERT_EQ(pack.validation, std::vector<std::size_t>{20});
  EXPECT_EQ(pack.frames->name(20), "2011_09_26_drive_0002_sync/image_02/0000000006");
  EXPECT_TRUE(pack.frames->read(20));
  EXPECT_TRUE(pack.frames->has_neighbours(19));
  EXPECT_FALSE(pack.frames->has_neighbours(20)) << "it is the drive's last";
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

TEST_F(KittiRaw, MissingPicturesFailWhenRead) {
  list(
      "2011_09_26/2011_09_26_drive_0002_sync 5 l\n"
      "2011_09_26/2011_09_26_drive_0002_sync 77 l\n"
      "2011_09_26/2011_09_26_drive_0009_sync 1 r\n");
  const FramesResult frames = open_kitti_raw(options_);
  ASSERT_TRUE(frames) << frames.status().text();
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
    const FramesResult frames = open_kitti_raw(options_);
    ASSERT_TRUE(frames) << frames.status().text();
    EXPECT_EQ((*frames)->size(), count) << name;
    EXPECT_TRUE((*frames)->read(0)) << (*frames)->read(0).status().text();
  }
}

}  // namespace
}  // namespace lcdm::model
