// Camera pixels as RGB, held to OpenCV's conversions; every format in tests/firmware.
#include "app/rgb_picture.h"

#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>
#include <random>

namespace lcdm {
namespace {

constexpr int kWidth = 38;
constexpr int kHeight = 11;
constexpr int kPadding = 6;  // bytes behind each row that belong to nobody

std::vector<std::uint8_t> random_bytes(std::size_t count) {
  std::mt19937 random(1);
  std::vector<std::uint8_t> bytes(count);
  for (auto& byte : bytes) byte = static_cast<std::uint8_t>(random());
  return bytes;
}

TEST(ToRgb, AgreesWithOpencvRowByRow) {
  const int stride = packed_stride(PixelFormat::kYuyv, kWidth) + kPadding;
  const auto bytes = random_bytes(static_cast<std::size_t>(stride) * kHeight);
  FrameView view;
  view.format = {PixelFormat::kYuyv, kWidth, kHeight, stride};
  view.data = bytes.data();
  view.bytes = bytes.size();
  RgbPicture picture;
  to_rgb(view, picture);

  const cv::Mat source(kHeight, kWidth, CV_8UC2, const_cast<std::uint8_t*>(bytes.data()),
                       static_cast<std::size_t>(stride));
  cv::Mat expected;
  cv::cvtColor(source, expected, cv::COLOR_YUV2RGB_YUYV);
  const cv::Mat actual(kHeight, kWidth, CV_8UC3, picture.pixels.data());
  EXPECT_LE(cv::norm(actual, expected, cv::NORM_INF), 1);
}

TEST(ToRgb, CopiesRgbRowByRow) {
  const auto bytes = random_bytes(static_cast<std::size_t>(kWidth * 3 + kPadding) * kHeight);
  FrameView view;
  view.format = {PixelFormat::kRgb24, kWidth, kHeight, kWidth * 3 + kPadding};
  view.data = bytes.data();
  view.bytes = bytes.size();
  RgbPicture picture;
  to_rgb(view, picture);
  const std::size_t last_row = static_cast<std::size_t>(kHeight - 1);
  EXPECT_EQ(picture.pixels[last_row * kWidth * 3], bytes[last_row * (kWidth * 3 + kPadding)]);
  EXPECT_EQ(picture.pixels.size(), static_cast<std::size_t>(kWidth * kHeight * 3));
}

TEST(SideBySide, PutsTheRightPictureBesideTheLeftAtItsSize) {
  RgbPicture left;
  left.resize(4, 2);
  left.pixels.assign(left.pixels.size(), 10);
  RgbPicture right;
  right.resize(2, 1);
  right.pixels = {1, 2, 3, 4, 5, 6};
  RgbPicture out;
  put_side_by_side(left, right, out);
  ASSERT_EQ(out.width, 8);
  ASSERT_EQ(out.height, 2);
  const std::vector<std::uint8_t> row = {10, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10,
                                         1,  2,  3,  1,  2,  3,  4,  5,  6,  4,  5,  6};
  EXPECT_EQ(std::vector<std::uint8_t>(out.pixels.begin(), out.pixels.begin() + 24), row);
  EXPECT_EQ(std::vector<std::uint8_t>(out.pixels.begin() + 24, out.pixels.end()), row);
}

}  // namespace
}  // namespace lcdm
