// A folder in the published layout of some data set, written by its test.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>
#include <iterator>
#include <map>
#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <string>

#include "model/frames.h"
#include "tests/support/temporary_folder.h"

namespace lcdm::model {

namespace fs = std::filesystem;
using FramesResult = Result<std::shared_ptr<const Frames>>;

inline const fs::path kFixtures = "tests/fixtures/datasets";  // see its README.md

inline cv::Mat_<std::uint16_t> no_depth(int rows, int columns) {
  return cv::Mat_<std::uint16_t>(rows, columns, std::uint16_t{0});
}

// An empty folder of the test's own, removed behind it.
class DataSet : public testing::Test {
 protected:
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

  test::TemporaryFolder scratch_;
  const fs::path root_ = scratch_.path();
};

// Every pixel but these is 0.
inline void expect_depth(const cv::Mat& depth, const std::map<std::array<int, 2>, float>& points) {
  for (int y = 0; y < depth.rows; ++y) {
    for (int x = 0; x < depth.cols; ++x) {
      const auto found = points.find({x, y});
      EXPECT_FLOAT_EQ(depth.at<float>(y, x), found == points.end() ? 0 : found->second)
          << "at x " << x << ", y " << y;
    }
  }
}

}  // namespace lcdm::model
