// Camera pixels to network input, against OpenCV; depth to millimetres.
#include "firmware/vision/preprocess.h"

#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <random>

#include "firmware/vision/depth_to_millimetres.h"

namespace lcdm {
namespace {

// Smooth shapes and noise, seeded; 8-bit with `channels`.
cv::Mat make_picture(int width, int height, int channels) {
  cv::Mat picture(height, width, CV_8UC(channels));
  std::mt19937 random(static_cast<unsigned>(width * height));
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width * channels; ++x) {
      const double wave = 100 + 60 * std::sin(x * 0.05) + 40 * std::cos(y * 0.11 + x * 0.01);
      picture.at<std::uint8_t>(y, x) =
          cv::saturate_cast<std::uint8_t>(wave + static_cast<double>(random() % 40));
    }
  }
  return picture;
}

FrameView view_of(const cv::Mat& picture, PixelFormat pixel) {
  FrameView view;
  view.format = {pixel, picture.cols, picture.rows, static_cast<int>(picture.step)};
  view.data = picture.data;
  view.bytes = picture.total() * picture.elemSize();
  return view;
}

cv::Mat preprocessed(const FrameView& frame, int width, int height, int workers = 1) {
  auto preprocess = Preprocess::prepare(frame.format, width, height, workers);
  EXPECT_TRUE(preprocess) << preprocess.status().text();
  EXPECT_TRUE(preprocess->check(frame));
  cv::Mat out(height, width, CV_32FC3);
  for (int worker = 0; worker < workers; ++worker) {
    preprocess->run_rows(frame, worker, height * worker / workers, height * (worker + 1) / workers,
                         out.ptr<float>());
  }
  return out;
}

// OpenCV's answer, each axis by its own factor: area when shrinking, bilinear otherwise.
cv::Mat expected_input(const cv::Mat& rgb, int width, int height) {
  cv::Mat image;
  rgb.convertTo(image, CV_32F);
  const auto how = [](int from, int to) { return from > to ? cv::INTER_AREA : cv::INTER_LINEAR; };
  cv::Mat wide;
  cv::resize(image, wide, {width, image.rows}, 0, 0, how(image.cols, width));
  cv::Mat out;
  cv::resize(wide, out, {width, height}, 0, 0, how(image.rows, height));
  return (out / 255.0 - cv::Scalar::all(0.45)) / 0.225;
}

double largest_difference(const cv::Mat& a, const cv::Mat& b) {
  return cv::norm(a, b, cv::NORM_INF);
}

TEST(Preprocess, ResizesAsOpenCvDoes) {
  const cv::Mat picture = make_picture(100, 60, 3);
  for (const auto& [width, height] :
       {std::pair(50, 30), std::pair(37, 23), std::pair(100, 60), std::pair(128, 96),
        std::pair(64, 96), std::pair(160, 32), std::pair(99, 61), std::pair(1, 1)}) {
    const cv::Mat input = preprocessed(view_of(picture, PixelFormat::kRgb24), width, height);
    EXPECT_LT(largest_difference(input, expected_input(picture, width, height)), 2e-4)
        << width << "x" << height;
  }
}

TEST(Preprocess, AreaOfBothAxesAtOnceIsOpenCvsInterArea) {
  const cv::Mat picture = make_picture(125, 77, 3);
  cv::Mat image;
  picture.convertTo(image, CV_32F, 1 / 255.0);
  cv::Mat small;
  cv::resize(image, small, {64, 32}, 0, 0, cv::INTER_AREA);
  const cv::Mat expected = (small - cv::Scalar::all(0.45)) / 0.225;
  const cv::Mat input = preprocessed(view_of(picture, PixelFormat::kRgb24), 64, 32);
  EXPECT_LT(largest_difference(input, expected), 2e-4);
}

TEST(Preprocess, BgrIsRgbInAnotherOrder) {
  const cv::Mat rgb = make_picture(80, 50, 3);
  cv::Mat bgr;
  cv::cvtColor(rgb, bgr, cv::COLOR_RGB2BGR);
  EXPECT_EQ(largest_difference(preprocessed(view_of(rgb, PixelFormat::kRgb24), 64, 32),
                               preprocessed(view_of(bgr, PixelFormat::kBgr24), 64, 32)),
            0);
}

TEST(Preprocess, YuyvIsBt601WithLimitedRange) {
  // Luma below 16 is not colour: OpenCV clamps it before the conversion, we after it.
  const cv::Mat yuyv = cv::max(make_picture(96, 64, 2), 16);
  cv::Mat rgb;
  cv::cvtColor(yuyv, rgb, cv::COLOR_YUV2RGB_YUYV);
  // OpenCV rounds to bytes in between: up to one step of 1/255.
  EXPECT_LT(largest_difference(preprocessed(view_of(yuyv, PixelFormat::kYuyv), 96, 64),
                               expected_input(rgb, 96, 64)),
            1.01 / 255 / 0.225);
  EXPECT_LT(largest_difference(preprocessed(view_of(yuyv, PixelFormat::kYuyv), 64, 32),
                               expected_input(rgb, 64, 32)),
            1.01 / 255 / 0.225);
}

TEST(Preprocess, RespectsTheStride) {
  const cv::Mat wide = make_picture(120, 40, 3);
  const cv::Mat left = wide.colRange(0, 80);
  FrameView view = view_of(left, PixelFormat::kRgb24);
  view.bytes = static_cast<std::size_t>(view.format.stride) * 39 + 80 * 3;
  EXPECT_LT(largest_difference(preprocessed(view, 64, 32), expected_input(left, 64, 32)), 2e-4);
}

TEST(Preprocess, WorkersShareTheRowsWithoutATrace) {
  const cv::Mat picture = make_picture(100, 90, 3);
  const FrameView view = view_of(picture, PixelFormat::kRgb24);
  EXPECT_EQ(largest_difference(preprocessed(view, 64, 64, 1), preprocessed(view, 64, 64, 3)), 0);
}

TEST(AxisTable, WeightsOfEveryOutputAddUpToOneWithinTheInput) {
  for (int in = 1; in < 40; ++in) {
    for (int out = 1; out < 40; ++out) {
      const AxisTable table = make_axis_table(in, out);
      for (int i = 0; i < out; ++i) {
        const int first = table.first[static_cast<std::size_t>(i)];
        ASSERT_GE(first, 0);
        ASSERT_LE(first + table.taps, in);
        float sum = 0;
        for (int t = 0; t < table.taps; ++t) {
          sum += table.weights[static_cast<std::size_t>(i * table.taps + t)];
        }
        ASSERT_NEAR(sum, 1, 1e-5) << in << " to " << out << " at " << i;
      }
    }
  }
}

TEST(DepthToMillimetres, RoundsAndMarksWhatHasNoValue) {
  const std::vector<float> metres = {1.0F,
                                     1.2344F,
                                     0.0006F,
                                     0.0004F,
                                     0.0F,
                                     -1.0F,
                                     65.534F,
                                     65.535F,
                                     1e9F,
                                     std::numeric_limits<float>::infinity(),
                                     std::numeric_limits<float>::quiet_NaN()};
  std::vector<std::uint16_t> millimetres(metres.size());
  depth_to_millimetres(metres, millimetres);
  EXPECT_EQ(millimetres,
            (std::vector<std::uint16_t>{1000, 1234, 1, 0, 0, 0, 65534, 65535, 65535, 65535, 0}));
}

}  // namespace
}  // namespace lcdm
