// What viewers get: each product from the newest frame, made only while somebody wants it.
#include "app/live_view.h"

#include <cstring>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "app/mjpeg_decoder.h"

namespace lcdm {
namespace {

using std::chrono::milliseconds;
using Subscription = LiveView::Subscription;
using Wait = LiveView::Wait;

constexpr int kWidth = 64;
constexpr int kHeight = 48;
constexpr int kDepthWidth = 32;
constexpr int kDepthHeight = 32;

// A frame of one colour and a ramp of depth, and the memory behind it.
class SomeFrame {
 public:
  explicit SomeFrame(std::uint64_t sequence, int width = kWidth, int height = kHeight)
      : pixels_(static_cast<std::size_t>(width * height * 3), 0),
        depth_(kDepthWidth * kDepthHeight) {
    for (std::size_t i = 0; i < pixels_.size(); i += 3) pixels_[i] = 200;  // red
    for (std::size_t i = 0; i < depth_.size(); ++i) {
      depth_[i] = static_cast<std::uint16_t>(1000 + 7 * i + sequence);
    }
    frame_.meta.sequence = sequence;
    frame_.camera = CameraModel::from_field_of_view(kDepthWidth, kDepthHeight, 65);
    frame_.millimetres = depth_.data();
    frame_.pixels = {{PixelFormat::kRgb24, width, height, width * 3},
                     frame_.meta,
                     pixels_.data(),
                     pixels_.size()};
    frame_.colour = frame_.pixels;
  }
  const DepthFrame& get() const { return frame_; }
  std::uint16_t depth_at(int x, int y) const {
    return depth_[static_cast<std::size_t>(y * kDepthWidth + x)];
  }

 private:
  std::vector<std::uint8_t> pixels_;
  std::vector<std::uint16_t> depth_;
  DepthFrame frame_;
};

// Offers frames until the product of one of them has come; the sequence is the product's.
ProductCopy make(LiveView& view, Product product, int width = kWidth, int height = kHeight) {
  Subscription subscription(view, product);
  ProductCopy copy;
  const std::uint64_t before = view.newest();
  for (std::uint64_t sequence = 1; sequence < 200; ++sequence) {
    view.offer(SomeFrame(sequence, width, height).get());
    if (subscription.wait_newer(before, milliseconds(20), copy) == Wait::kNewer) return copy;
  }
  ADD_FAILURE() << "no product came";
  return copy;
}

cv::Mat decode(std::span<const std::byte> bytes) {
  const cv::Mat flat(1, static_cast<int>(bytes.size()), CV_8U,
                     const_cast<std::byte*>(bytes.data()));
  return cv::imdecode(flat, cv::IMREAD_UNCHANGED);
}

TEST(LiveView, GivesTheColourPicture) {
  LiveView view("test:");
  const cv::Mat picture = decode(make(view, Product::kColourJpeg).bytes);
  ASSERT_EQ(picture.size(), cv::Size(kWidth, kHeight));
  const auto pixel = picture.at<cv::Vec3b>(kHeight / 2, kWidth / 2);
  EXPECT_NEAR(pixel[2], 200, 6) << "red";
  EXPECT_NEAR(pixel[0], 0, 6);
}

TEST(LiveView, GivesDepthAsColoursAndBesideTheColourPicture) {
  LiveView view("test:");
  EXPECT_EQ(decode(make(view, Product::kDepthJpeg).bytes).size(),
            cv::Size(kDepthWidth, kDepthHeight));
  const cv::Mat side = decode(make(view, Product::kSideJpeg).bytes);
  ASSERT_EQ(side.size(), cv::Size(2 * kWidth, kHeight));
  const auto nearest = side.at<cv::Vec3b>(2, kWidth + 8);
  const auto farthest = side.at<cv::Vec3b>(kHeight - 3, 2 * kWidth - 8);
  EXPECT_GT(nearest[2], nearest[0]) << "near is warm";
  EXPECT_LT(farthest[2], farthest[0] + 40) << "far is cool";
}

TEST(LiveView, GivesDepthItselfAsPng) {
  LiveView view("test:");
  const ProductCopy copy = make(view, Product::kDepthPng);
  const cv::Mat depth = decode(copy.bytes);
  ASSERT_EQ(depth.type(), CV_16UC1);
  const SomeFrame frame(copy.meta.sequence);
  EXPECT_EQ(depth.at<std::uint16_t>(0, 0), frame.depth_at(0, 0));
  EXPECT_EQ(depth.at<std::uint16_t>(31, 30), frame.depth_at(30, 31));
  const std::string bytes(reinterpret_cast<const char*>(copy.bytes.data()), copy.bytes.size());
  EXPECT_THAT(bytes, testing::HasSubstr("tEXtscale"));
  EXPECT_THAT(bytes, testing::HasSubstr("relative"));
  EXPECT_THAT(bytes, testing::HasSubstr("test:"));
  EXPECT_THAT(bytes, testing::HasSubstr(std::string("tEXtfx\0", 7) +
                                        std::to_string(frame.get().camera.fx)));
  EXPECT_THAT(bytes, testing::HasSubstr(std::string("tEXtcalibrated\0no", 17)));
}

TEST(LiveView, GivesColourAndDepthOfOneFrameToThePage) {
  LiveView view("test:");
  const ProductCopy copy = make(view, Product::kLive);
  ASSERT_EQ(copy.bytes.size() - copy.picture_bytes, 2U * kDepthWidth * kDepthHeight);
  EXPECT_EQ(decode(std::span(copy.bytes).first(copy.picture_bytes)).cols, kWidth);
  std::uint16_t last = 0;
  std::memcpy(&last, copy.bytes.data() + copy.bytes.size() - 2, 2);
  EXPECT_EQ(last, SomeFrame(copy.meta.sequence).depth_at(31, 31));
  EXPECT_EQ(copy.camera.width, kDepthWidth);
}

TEST(LiveView, FollowsACameraThatChangesItsSize) {
  LiveView view("test:");
  EXPECT_EQ(decode(make(view, Product::kColourJpeg).bytes).cols, kWidth);
  EXPECT_EQ(decode(make(view, Product::kColourJpeg, 160, 100).bytes).cols, 160);
  EXPECT_EQ(decode(make(view, Product::kColourJpeg, 32, 20).bytes).cols, 32);
}

TEST(LiveView, MakesNothingForNobody) {
  LiveView view("test:");
  make(view, Product::kDepthPng);
  const std::uint64_t made = view.newest();
  for (int i = 0; i < 5; ++i) view.offer(SomeFrame(1).get());
  EXPECT_EQ(view.newest(), made + 5) << "frames are numbered, encoded or not";
  ProductCopy copy;
  Subscription late(view, Product::kDepthPng);
  EXPECT_EQ(late.wait_newer(made, milliseconds(100), copy), Wait::kTimeout);
  EXPECT_EQ(late.wait_newer(made - 1, milliseconds(0), copy), Wait::kNewer) << "the last one made";
}

TEST(LiveView, ASlowViewerSkipsFrames) {
  LiveView view("test:");
  Subscription slow(view, Product::kColourJpeg);
  ProductCopy copy = make(view, Product::kColourJpeg);
  for (std::uint64_t sequence = 100; sequence < 130; ++sequence) {
    view.offer(SomeFrame(sequence).get());
    std::this_thread::sleep_for(milliseconds(3));
  }
  ASSERT_EQ(slow.wait_newer(copy.number, milliseconds(1000), copy), Wait::kNewer);
  EXPECT_GT(copy.meta.sequence, 120U) << "the newest, not the next";
}

TEST(LiveView, StoppingWakesItsViewers) {
  LiveView view("test:");
  std::thread viewer([&view] {
    Subscription subscription(view, Product::kLive);
    ProductCopy copy;
    EXPECT_EQ(subscription.wait_newer(0, milliseconds(60'000), copy), Wait::kClosed);
  });
  std::this_thread::sleep_for(milliseconds(50));
  view.stop();
  viewer.join();
  view.offer(SomeFrame(1).get());  // harmless
}

TEST(MjpegDecoder, GivesThePixelsOfAJpegAndRefusesABrokenOne) {
  std::vector<std::uint8_t> jpeg;
  cv::imencode(".jpg", cv::Mat(kHeight, kWidth, CV_8UC3, cv::Scalar(10, 120, 220)), jpeg);
  MjpegDecoder decoder;
  const FrameFormat compressed{PixelFormat::kMjpeg, kWidth, kHeight, 0};
  const auto format = decoder.prepare(compressed);
  ASSERT_TRUE(format);
  EXPECT_EQ(*format, (FrameFormat{PixelFormat::kRgb24, kWidth, kHeight, 3 * kWidth}));
  FrameView frame{compressed, {}, jpeg.data(), jpeg.size()};
  frame.meta.sequence = 5;
  const auto pixels = decoder.decode(frame);
  ASSERT_TRUE(pixels) << pixels.status().text();
  EXPECT_EQ(pixels->meta.sequence, 5U);
  EXPECT_NEAR(pixels->data[0], 220, 4);
  EXPECT_NEAR(pixels->data[2], 10, 4);
  frame.bytes /= 3;
  EXPECT_EQ(decoder.decode(frame).code(), StatusCode::kCorrupt);
}

}  // namespace
}  // namespace lcdm
