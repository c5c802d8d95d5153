// Camera pixels to network input, against OpenCV; depth to millimetres.
#include "firmware/vision/preprocess.h"

#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <memory>
#include <opencv2/imgproc.hpp>
#include <random>

#include "firmware/vision/depth_to_millimetres.h"
#include "firmware/vision/rgb_row.h"
#include "tests/firmware/isa.h"

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

// How OpenCV names a pixel format.
struct Peer {
  PixelFormat pixel;
  int type;  // of the picture as a matrix
  int code;  // of cvtColor to RGB
};
constexpr Peer kPeers[] = {
    {PixelFormat::kBgr24, CV_8UC3, cv::COLOR_BGR2RGB},
    {PixelFormat::kYuyv, CV_8UC2, cv::COLOR_YUV2RGB_YUYV},
    {PixelFormat::kUyvy, CV_8UC2, cv::COLOR_YUV2RGB_UYVY},
    {PixelFormat::kNv12, CV_8UC1, cv::COLOR_YUV2RGB_NV12},
    {PixelFormat::kNv21, CV_8UC1, cv::COLOR_YUV2RGB_NV21},
    {PixelFormat::kGrey, CV_8UC1, cv::COLOR_GRAY2RGB},
};

// A frame that ends where its memory ends, so that a sanitizer sees a byte read too many, and what
// OpenCV makes of it.
struct PeerFrame {
  std::unique_ptr<std::uint8_t[]> bytes;
  FrameView view;
  cv::Mat rgb;

  PeerFrame(const Peer& peer, int width, int height, int padding, bool extreme) {
    const int stride = packed_stride(peer.pixel, width) + padding;
    view.format = {peer.pixel, width, height, stride};
    view.bytes = picture_bytes(view.format);
    bytes = std::make_unique<std::uint8_t[]>(view.bytes);
    view.data = bytes.get();
    std::mt19937 random(static_cast<unsigned>(width * height));
    for (std::size_t i = 0; i < view.bytes; ++i) {
      bytes[i] = static_cast<std::uint8_t>(extreme ? random() : 60 + i % 90 + random() % 40);
    }
    const bool planes = peer.pixel == PixelFormat::kNv12 || peer.pixel == PixelFormat::kNv21;
    const int rows = planes ? height + height / 2 : height;
    std::vector<std::uint8_t> whole(static_cast<std::size_t>(rows) * stride);
    std::copy_n(bytes.get(), view.bytes, whole.begin());
    const cv::Mat picture(rows, width, peer.type, whole.data(), static_cast<std::size_t>(stride));
    cv::cvtColor(picture, rgb, peer.code);
  }
};

// Both round to bytes, OpenCV with coefficients of fewer digits.
TEST(RgbRow, IsOpenCvsColourForEveryFormatWidthAndInstructionSet) {
  test::for_each_isa([] {
    for (const Peer& peer : kPeers) {
      for (const int width : {2, 14, 64, 66, 94, 162}) {
        const PeerFrame frame(peer, width, 6, width % 7, true);
        cv::Mat rgb(6, width, CV_8UC3);
        for (int y = 0; y < 6; ++y) rgb_row(frame.view, y, rgb.ptr(y));
        ASSERT_LE(largest_difference(rgb, frame.rgb), is_yuv(peer.pixel) ? 1 : 0)
            << to_string(peer.pixel) << " " << width;
      }
    }
  });
}

TEST(RgbRow, IsTheSameOnEveryInstructionSet) {
  for (const Peer& peer : kPeers) {
    const PeerFrame frame(peer, 158, 2, 0, true);
    std::vector<std::uint8_t> first;
    test::for_each_isa([&] {
      std::vector<std::uint8_t> rgb(158 * 3);
      rgb_row(frame.view, 1, rgb.data());
      if (first.empty()) first = rgb;
      ASSERT_EQ(rgb, first) << to_string(peer.pixel);
    });
  }
}

TEST(Preprocess, TakesEveryFormatAsOpenCvDoes) {
  test::for_each_isa([] {
    for (const Peer& peer : kPeers) {
      for (const auto& [width, height] :
           {std::pair(96, 64), std::pair(150, 82), std::pair(34, 10)}) {
        for (const int padding : {0, 10}) {
          const PeerFrame frame(peer, width, height, padding, false);
          ASSERT_LT(largest_difference(preprocessed(frame.view, 64, 32),
                                       expected_input(frame.rgb, 64, 32)),
                    is_yuv(peer.pixel) ? 1.01 / 255 / 0.225 : 2e-4)
              << to_string(peer.pixel) << " " << width << "x" << height << " + " << padding;
        }
      }
    }
  });
}

TEST(Preprocess, RefusesWhatCannotBeAPicture) {
  for (const FrameFormat& format :
       {FrameFormat{PixelFormat::kYuyv, 3, 2, 6}, FrameFormat{PixelFormat::kUyvy, 3, 2, 6},
        FrameFormat{PixelFormat::kNv12, 4, 3, 4}, FrameFormat{PixelFormat::kNv21, 3, 2, 4},
        FrameFormat{PixelFormat::kGrey, 4, 4, 3}, FrameFormat{PixelFormat::kGrey, 0, 4, 4},
        FrameFormat{PixelFormat::kGrey, 4, 9000, 4}}) {
    EXPECT_EQ(Preprocess::prepare(format, 64, 32, 1).code(), StatusCode::kInvalidInput)
        << to_string(format.pixel);
  }
  const PeerFrame frame(kPeers[3], 64, 32, 0, false);
  auto preprocess = Preprocess::prepare(frame.view.format, 64, 32, 1);
  ASSERT_TRUE(preprocess);
  FrameView cut = frame.view;
  EXPECT_TRUE(preprocess->check(cut));
  cut.bytes -= 1;
  EXPECT_EQ(preprocess->check(cut).code(), StatusCode::kInvalidInput) << "its chroma ends early";
}

TEST(Preprocess, RespectsTheStride) {
  const cv::Mat wide = make_picture(120, 40, 3);
  const cv::Mat left = wide.colRange(0, 80);
  FrameView view = view_of(left, PixelFormat::kRgb24);
  view.bytes = static_cast<std::size_t>(view.format.stride) * 39 + 80 * 3;
  EXPECT_LT(largest_difference(preprocessed(view, 64, 32), expected_input(left, 64, 32)), 2e-4);
}

TEST(Preprocess, WorkersShareTheRowsWithoutATrace) {
  for (const Peer& peer : kPeers) {
    const PeerFrame frame(peer, 100, 90, 0, true);
    EXPECT_EQ(largest_difference(preprocessed(frame.view, 64, 64, 1),
                                 preprocessed(frame.view, 64, 64, 3)),
              0)
        << to_string(peer.pixel);
  }
}

TEST(Preprocess, KeepsNothingOfThePreviousFrame) {
  const PeerFrame first(kPeers[1], 100, 90, 0, true);
  const PeerFrame second(kPeers[1], 100, 90, 0, false);
  auto preprocess = Preprocess::prepare(first.view.format, 64, 64, 1);
  cv::Mat out(64, 64, CV_32FC3);
  preprocess->run_rows(first.view, 0, 0, 64, out.ptr<float>());
  preprocess->run_rows(second.view, 0, 0, 64, out.ptr<float>());
  EXPECT_EQ(largest_difference(out, preprocessed(second.view, 64, 64)), 0);
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
