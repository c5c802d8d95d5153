// The codecs against OpenCV, whose readers and writers are not ours.
#include "drivers/codec/codec.h"

#include <algorithm>
#include <cmath>
#include <gtest/gtest.h>
#include <iterator>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <random>

#include "firmware/base/alloc_watch.h"
#include "tests/support/temporary_folder.h"

namespace lcdm {
namespace {

using test::TemporaryFolder;

// Smooth colours with a few edges: what JPEG is for. RGB.
cv::Mat test_picture(int width, int height) {
  cv::Mat picture(height, width, CV_8UC3);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      picture.at<cv::Vec3b>(y, x) =
          cv::Vec3b(static_cast<uchar>(x * 255 / width), static_cast<uchar>(y * 255 / height),
                    (x / 32 + y / 32) % 2 == 0 ? 60 : 190);
    }
  }
  return picture;
}

FrameView view_of(const cv::Mat& pixels, PixelFormat format) {
  const FrameFormat description{format, pixels.cols, pixels.rows, static_cast<int>(pixels.step)};
  return {description, {}, pixels.data, pixels.step * static_cast<std::size_t>(pixels.rows)};
}

std::vector<std::byte> encoded(const FrameView& frame, int quality = 92) {
  JpegEncoder encoder;
  const Status prepared = encoder.prepare(frame.format, quality);
  EXPECT_TRUE(prepared) << prepared.text();
  std::vector<std::byte> out(1U << 20);
  const auto size = encoder.encode(frame, out);
  EXPECT_TRUE(size) << size.status().text();
  out.resize(size ? *size : 0);
  return out;
}

cv::Mat opencv_decoded(const std::vector<std::byte>& jpeg) {
  const cv::Mat bytes(1, static_cast<int>(jpeg.size()), CV_8U, const_cast<std::byte*>(jpeg.data()));
  cv::Mat rgb;
  cv::cvtColor(cv::imdecode(bytes, cv::IMREAD_COLOR), rgb, cv::COLOR_BGR2RGB);
  return rgb;
}

std::vector<std::uint8_t> opencv_jpeg(const cv::Mat& rgb, const std::vector<int>& options = {}) {
  cv::Mat bgr;
  cv::cvtColor(rgb, bgr, cv::COLOR_RGB2BGR);
  std::vector<std::uint8_t> jpeg;
  cv::imencode(".jpg", bgr, jpeg, options);
  return jpeg;
}

Status decode(std::span<const std::uint8_t> jpeg, cv::Mat& rgb) {
  JpegDecoder decoder;
  EXPECT_TRUE(decoder.prepare(rgb.cols, rgb.rows));
  return decoder.decode(jpeg, {rgb.data, rgb.total() * 3});
}

// ---- JPEG, out ----------------------------------------------------------------------------------

class JpegSizes : public ::testing::TestWithParam<std::pair<int, int>> {};

TEST_P(JpegSizes, RgbAndBgrSurviveTheWayToOpenCv) {
  const auto [width, height] = GetParam();
  const cv::Mat rgb = test_picture(width, height);
  cv::Mat bgr;
  cv::cvtColor(rgb, bgr, cv::COLOR_RGB2BGR);
  const double least = width < 16 ? 12 : 28;  // colour is halved: hard on two pixels
  EXPECT_GT(cv::PSNR(rgb, opencv_decoded(encoded(view_of(rgb, PixelFormat::kRgb24)))), least);
  EXPECT_EQ(encoded(view_of(rgb, PixelFormat::kRgb24)), encoded(view_of(bgr, PixelFormat::kBgr24)));
}

TEST_P(JpegSizes, YuyvIsWidenedToTheFullRangeOfJpeg) {
  const auto [width, height] = GetParam();
  if (width % 2 != 0) GTEST_SKIP() << "YUYV has even widths";
  std::mt19937 random(7);
  cv::Mat yuyv(height, width, CV_8UC2);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const int luma = 16 + 219 * (x + y) / (width + height);
      const int chroma = 100 + 50 * (x % 2 == 0 ? y : height - y) / height;
      yuyv.at<cv::Vec2b>(y, x) = cv::Vec2b(static_cast<uchar>(luma), static_cast<uchar>(chroma));
    }
  }
  cv::Mat expected;  // OpenCV's conversion is BT.601 video range
  cv::cvtColor(yuyv, expected, cv::COLOR_YUV2RGB_YUYV);
  EXPECT_GT(cv::PSNR(expected, opencv_decoded(encoded(view_of(yuyv, PixelFormat::kYuyv), 95))), 36);
}

// One picture with a chroma of its own for every pair of rows, in each way to write it down.
TEST(JpegEncoder, TakesEveryKindOfYuvAlike) {
  constexpr int kWidth = 38;
  constexpr int kHeight = 22;
  cv::Mat yuyv(kHeight, kWidth, CV_8UC2);
  cv::Mat uyvy(kHeight, kWidth, CV_8UC2);
  cv::Mat nv12(kHeight * 3 / 2, kWidth, CV_8UC1);
  cv::Mat nv21(kHeight * 3 / 2, kWidth, CV_8UC1);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const auto luma = static_cast<uchar>(16 + 3 * x + 2 * y);
      const auto chroma = static_cast<uchar>(x % 2 == 0 ? 100 + x + y / 2 : 150 - x + y / 2);
      yuyv.at<cv::Vec2b>(y, x) = {luma, chroma};
      uyvy.at<cv::Vec2b>(y, x) = {chroma, luma};
      nv12.at<uchar>(y, x) = nv21.at<uchar>(y, x) = luma;
      nv12.at<uchar>(kHeight + y / 2, x) = chroma;
      nv21.at<uchar>(kHeight + y / 2, x ^ 1) = chroma;
    }
  }
  const auto planes = [](const cv::Mat& picture, PixelFormat format) {
    FrameView view = view_of(picture, format);
    view.format.height = kHeight;
    return view;
  };
  const auto expected = encoded(view_of(yuyv, PixelFormat::kYuyv));
  EXPECT_EQ(encoded(view_of(uyvy, PixelFormat::kUyvy)), expected);
  EXPECT_EQ(encoded(planes(nv12, PixelFormat::kNv12)), expected);
  EXPECT_EQ(encoded(planes(nv21, PixelFormat::kNv21)), expected);
}

TEST(JpegEncoder, WritesGreyAsGrey) {
  cv::Mat grey;
  cv::cvtColor(test_picture(130, 70), grey, cv::COLOR_RGB2GRAY);
  const auto jpeg = encoded(view_of(grey, PixelFormat::kGrey), 95);
  const cv::Mat bytes(1, static_cast<int>(jpeg.size()), CV_8UC1,
                      const_cast<std::byte*>(jpeg.data()));
  const cv::Mat decoded = cv::imdecode(bytes, cv::IMREAD_UNCHANGED);
  ASSERT_EQ(decoded.type(), CV_8UC1);
  EXPECT_GT(cv::PSNR(grey, decoded), 36);
}

TEST_P(JpegSizes, WhatOpenCvWritesDecodesToWhatOpenCvReads) {
  const auto [width, height] = GetParam();
  const cv::Mat rgb = test_picture(width, height);
  const auto jpeg = opencv_jpeg(rgb);
  cv::Mat ours(height, width, CV_8UC3);
  const Status status = decode(jpeg, ours);
  ASSERT_TRUE(status) << status.text();
  cv::Mat theirs;
  cv::cvtColor(cv::imdecode(jpeg, cv::IMREAD_COLOR), theirs, cv::COLOR_BGR2RGB);
  EXPECT_LE(cv::norm(ours, theirs, cv::NORM_INF), 1);
}

INSTANTIATE_TEST_SUITE_P(Codec, JpegSizes,
                         ::testing::Values(std::pair{640, 480}, std::pair{1242, 375},
                                           std::pair{17, 9}, std::pair{2, 1}, std::pair{1, 1},
                                           std::pair{1920, 1080}));

TEST(JpegEncoder, HeedsTheStrideOfItsFrames) {
  const cv::Mat wide = test_picture(128, 64);
  const cv::Mat part = wide(cv::Rect(32, 8, 64, 48));
  EXPECT_EQ(encoded(view_of(part, PixelFormat::kRgb24)),
            encoded(view_of(part.clone(), PixelFormat::kRgb24)));
}

// Nothing is larger than noise.
TEST(JpegWriter, HasRoomForNoiseOfEverySize) {
  JpegWriter writer(kKeptQuality);
  for (const auto& [width, height] : {std::pair{1, 1}, {17, 9}, {640, 480}}) {
    cv::Mat noise(height, width, CV_8UC3);
    cv::randu(noise, 0, 256);
    const auto jpeg = writer.encode(view_of(noise, PixelFormat::kRgb24));
    ASSERT_TRUE(jpeg) << width << ": " << jpeg.status().text();
    cv::Mat yuyv(height, width, CV_8UC2);
    cv::randu(yuyv, 0, 256);
    if (width % 2 != 0) continue;
    EXPECT_TRUE(writer.encode(view_of(yuyv, PixelFormat::kYuyv)));
  }
}

TEST(JpegEncoder, SaysWhenTheSpaceIsTooSmallAndGoesOnWorking) {
  const cv::Mat rgb = test_picture(320, 240);
  const FrameView frame = view_of(rgb, PixelFormat::kRgb24);
  JpegEncoder encoder;
  ASSERT_TRUE(encoder.prepare(frame.format, 90));
  std::vector<std::byte> out(1U << 18);
  for (const std::size_t room : {0U, 1U, 100U, 2000U}) {
    EXPECT_EQ(encoder.encode(frame, std::span(out).first(room)).code(), StatusCode::kOutOfMemory);
  }
  const auto size = encoder.encode(frame, out);
  ASSERT_TRUE(size);
  EXPECT_TRUE(encoder.encode(frame, std::span(out).first(*size + 1)));
  EXPECT_FALSE(encoder.encode(frame, std::span(out).first(*size - 1)));
}

TEST(JpegEncoder, RefusesFramesItWasNotPreparedFor) {
  const cv::Mat rgb = test_picture(64, 48);
  std::vector<std::byte> out(1U << 16);
  JpegEncoder encoder;
  EXPECT_EQ(encoder.encode(view_of(rgb, PixelFormat::kRgb24), out).code(),
            StatusCode::kInvalidInput);
  ASSERT_TRUE(encoder.prepare({PixelFormat::kRgb24, 64, 48, 192}, 90));
  EXPECT_EQ(encoder.encode(view_of(rgb, PixelFormat::kBgr24), out).code(),
            StatusCode::kInvalidInput);
  FrameView cut = view_of(rgb, PixelFormat::kRgb24);
  --cut.bytes;
  EXPECT_EQ(encoder.encode(cut, out).code(), StatusCode::kInvalidInput);
  for (const FrameFormat& bad :
       {FrameFormat{PixelFormat::kMjpeg, 64, 48, 0}, FrameFormat{PixelFormat::kRgb24, 0, 48, 0},
        FrameFormat{PixelFormat::kRgb24, 64, 48, 100}, FrameFormat{PixelFormat::kYuyv, 3, 3, 6},
        FrameFormat{PixelFormat::kRgb24, 100'000, 1, 300'000}}) {
    EXPECT_EQ(encoder.prepare(bad, 90).code(), StatusCode::kInvalidInput);
  }
  EXPECT_EQ(encoder.prepare({PixelFormat::kRgb24, 64, 48, 192}, 0).code(),
            StatusCode::kInvalidInput);
}

TEST(JpegCodec, AllocatesNothingPerFrame) {
  if (!alloc_watch::hooked()) GTEST_SKIP() << "built with a sanitizer, which owns malloc";
  const cv::Mat rgb = test_picture(640, 480);
  const cv::Mat yuyv(480, 640, CV_8UC2, cv::Scalar(90, 130));
  std::vector<std::byte> out(1U << 20);
  cv::Mat back(480, 640, CV_8UC3);
  JpegEncoder from_rgb;
  JpegEncoder from_yuyv;
  JpegDecoder decoder;
  ASSERT_TRUE(from_rgb.prepare(view_of(rgb, PixelFormat::kRgb24).format, 90));
  ASSERT_TRUE(from_yuyv.prepare(view_of(yuyv, PixelFormat::kYuyv).format, 90));
  ASSERT_TRUE(decoder.prepare(640, 480));
  const auto jpeg = opencv_jpeg(rgb);

  const std::uint64_t before = alloc_watch::thread_allocations();
  for (int i = 0; i < 20; ++i) {
    ASSERT_TRUE(from_rgb.encode(view_of(rgb, PixelFormat::kRgb24), out));
    ASSERT_TRUE(from_yuyv.encode(view_of(yuyv, PixelFormat::kYuyv), out));
    ASSERT_TRUE(decoder.decode(jpeg, {back.data, back.total() * 3}));
    ASSERT_FALSE(decoder.decode(std::span(jpeg).first(500), {back.data, back.total() * 3}));
  }
  EXPECT_EQ(alloc_watch::thread_allocations(), before);
}

// ---- JPEG, in: untrusted ------------------------------------------------------------------------

TEST(JpegDecoder, UnderstandsMotionJpegWithoutHuffmanTables) {
  const cv::Mat rgb = test_picture(160, 120);
  std::vector<std::uint8_t> jpeg = opencv_jpeg(rgb);
  cv::Mat whole(120, 160, CV_8UC3);
  ASSERT_TRUE(decode(jpeg, whole));
  // Cuts every DHT segment (FF C4) out of the header.
  std::size_t at = 2;
  int cut = 0;
  while (jpeg[at] == 0xFF && jpeg[at + 1] != 0xDA) {
    const std::size_t length = 2U + jpeg[at + 2] * 256U + jpeg[at + 3];
    if (jpeg[at + 1] != 0xC4) {
      at += length;
      continue;
    }
    const auto begin = jpeg.begin() + static_cast<std::ptrdiff_t>(at);
    jpeg.erase(begin, begin + static_cast<std::ptrdiff_t>(length));
    ++cut;
  }
  ASSERT_GT(cut, 0);
  cv::Mat without(120, 160, CV_8UC3);
  const Status status = decode(jpeg, without);
  ASSERT_TRUE(status) << status.text();
  EXPECT_EQ(cv::norm(whole, without, cv::NORM_INF), 0);
}

TEST(JpegDecoder, StrayBytesBetweenMarkersAreForgiven) {
  const cv::Mat rgb = test_picture(160, 120);
  std::vector<std::uint8_t> jpeg = opencv_jpeg(rgb);
  const std::size_t length = 2U + jpeg[4] * 256U + jpeg[5];
  jpeg.insert(jpeg.begin() + static_cast<std::ptrdiff_t>(2 + length), {0, 0, 0});
  cv::Mat back(120, 160, CV_8UC3);
  const Status status = decode(jpeg, back);
  EXPECT_TRUE(status) << status.text();
}

TEST(JpegDecoder, ACutPictureIsCorruptWhereverItWasCut) {
  const auto jpeg = opencv_jpeg(test_picture(160, 120));
  cv::Mat rgb(120, 160, CV_8UC3);
  for (std::size_t length = 0; length + 2 < jpeg.size(); length += 7) {
    EXPECT_EQ(decode(std::span(jpeg).first(length), rgb).code(), StatusCode::kCorrupt) << length;
  }
}

TEST(JpegDecoder, OtherSizesAndKindsAreRefused) {
  const cv::Mat rgb = test_picture(160, 120);
  cv::Mat other(121, 160, CV_8UC3);
  EXPECT_EQ(decode(opencv_jpeg(rgb), other).code(), StatusCode::kCorrupt);
  cv::Mat same(120, 160, CV_8UC3);
  EXPECT_EQ(decode(opencv_jpeg(rgb, {cv::IMWRITE_JPEG_PROGRESSIVE, 1}), same).code(),
            StatusCode::kUnsupported);
}

TEST(JpegDecoder, GreyPicturesComeAsColour) {
  cv::Mat grey(48, 64, CV_8U, cv::Scalar(77));
  std::vector<std::uint8_t> jpeg;
  cv::imencode(".jpg", grey, jpeg);
  cv::Mat rgb(48, 64, CV_8UC3);
  ASSERT_TRUE(decode(jpeg, rgb));
  EXPECT_EQ(rgb.at<cv::Vec3b>(20, 20), cv::Vec3b(77, 77, 77));
}

TEST(JpegDecoder, HostileBytesNeverCrashAndItStaysUsable) {
  const auto jpeg = opencv_jpeg(test_picture(64, 48));
  std::mt19937 random(11);
  JpegDecoder decoder;
  ASSERT_TRUE(decoder.prepare(64, 48));
  std::vector<std::uint8_t> rgb(9216);
  for (int i = 0; i < 4000; ++i) {
    std::vector<std::uint8_t> hostile = jpeg;
    const int changes = 1 + static_cast<int>(random() % 6);
    for (int k = 0; k < changes; ++k) {
      hostile[random() % hostile.size()] = static_cast<std::uint8_t>(random());
    }
    if (i % 5 == 0) hostile.resize(random() % hostile.size());
    const Status status = decoder.decode(hostile, rgb);
    EXPECT_TRUE(status || status.code() == StatusCode::kCorrupt ||
                status.code() == StatusCode::kUnsupported)
        << status.text();
  }
  EXPECT_TRUE(decoder.decode(jpeg, rgb));
}

// ---- PNG ----------------------------------------------------------------------------------------

std::vector<std::uint16_t> test_depth(int width, int height) {
  std::vector<std::uint16_t> depth(static_cast<std::size_t>(width) *
                                   static_cast<std::size_t>(height));
  for (std::size_t i = 0; i < depth.size(); ++i) {
    depth[i] = static_cast<std::uint16_t>(i * 2654435761U >> 13);
  }
  depth.front() = 0;
  depth.back() = 65535;
  return depth;
}

std::string text_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

TEST(DepthPng, OpenCvReadsEveryMillimetre) {
  const TemporaryFolder folder;
  const std::string path = folder.file("depth.png");
  const auto depth = test_depth(97, 31);
  const Status status =
      write_depth_png(path, depth, 97, 31, std::vector<ImageText>{{"scale", "relative"}});
  ASSERT_TRUE(status) << status.text();
  const cv::Mat read = cv::imread(path, cv::IMREAD_UNCHANGED);
  ASSERT_EQ(read.type(), CV_16U);
  ASSERT_EQ(read.size(), cv::Size(97, 31));
  EXPECT_TRUE(std::equal(depth.begin(), depth.end(), read.begin<std::uint16_t>()));
  EXPECT_NE(text_of(path).find(std::string("tEXtscale\0relative", 18)), std::string::npos);
}

TEST(DepthPng, MemoryAndFileHoldTheSameBytes) {
  const TemporaryFolder folder;
  const auto depth = test_depth(40, 30);
  std::vector<std::byte> bytes{std::byte{1}};  // what was there before is replaced
  ASSERT_TRUE(encode_depth_png(depth, 40, 30, {}, bytes));
  ASSERT_TRUE(write_depth_png(folder.file("a.png"), depth, 40, 30));
  const std::string file = text_of(folder.file("a.png"));
  ASSERT_EQ(file.size(), bytes.size());
  EXPECT_EQ(std::memcmp(file.data(), bytes.data(), bytes.size()), 0);
}

TEST(DepthPng, ReadsWhatOpenCvWrites) {
  const TemporaryFolder folder;
  auto depth = test_depth(33, 21);
  cv::imwrite(folder.file("d.png"), cv::Mat(21, 33, CV_16U, depth.data()));
  const auto image = read_depth_png(folder.file("d.png"));
  ASSERT_TRUE(image) << image.status().text();
  EXPECT_EQ(image->width, 33);
  EXPECT_EQ(image->height, 21);
  EXPECT_EQ(image->values, depth);
}

TEST(DepthPng, ForeignAndBrokenFilesAreRefusedByName) {
  const TemporaryFolder folder;
  cv::imwrite(folder.file("8bit.png"), cv::Mat(10, 10, CV_8U, cv::Scalar(5)));
  EXPECT_EQ(read_depth_png(folder.file("8bit.png")).code(), StatusCode::kUnsupported);
  EXPECT_EQ(read_depth_png(folder.write("text.png", "no picture")).code(), StatusCode::kCorrupt);
  EXPECT_EQ(read_depth_png(folder.write("empty.png", "")).code(), StatusCode::kCorrupt);
  const auto missing = read_depth_png(folder.file("missing.png"));
  EXPECT_EQ(missing.code(), StatusCode::kIoError);
  EXPECT_NE(std::string(missing.status().text()).find("missing.png"), std::string::npos);

  ASSERT_TRUE(write_depth_png(folder.file("whole.png"), test_depth(64, 64), 64, 64));
  const std::string whole = text_of(folder.file("whole.png"));
  for (std::size_t length = 1; length < whole.size() - 12; length += 97) {
    const std::string cut = folder.write("cut.png", std::string_view(whole).substr(0, length));
    EXPECT_EQ(read_depth_png(cut).code(), StatusCode::kCorrupt) << length;
  }
}

TEST(DepthPng, ValuesAndKeysMustFit) {
  std::vector<std::byte> out;
  const auto depth = test_depth(4, 4);
  EXPECT_EQ(encode_depth_png(depth, 5, 4, {}, out).code(), StatusCode::kInvalidInput);
  EXPECT_EQ(encode_depth_png(depth, -4, -4, {}, out).code(), StatusCode::kInvalidInput);
  const std::vector<ImageText> no_key{{"", "x"}};
  EXPECT_EQ(encode_depth_png(depth, 4, 4, no_key, out).code(), StatusCode::kInvalidInput);
}

TEST(RgbPng, OpenCvReadsTheSameColours) {
  const TemporaryFolder folder;
  const cv::Mat rgb = test_picture(50, 20);
  ASSERT_TRUE(write_rgb_png(folder.file("c.png"), {rgb.data, rgb.total() * 3}, 50, 20));
  cv::Mat read;
  cv::cvtColor(cv::imread(folder.file("c.png"), cv::IMREAD_COLOR), read, cv::COLOR_BGR2RGB);
  EXPECT_EQ(cv::norm(read, rgb, cv::NORM_INF), 0);
}

// ---- TIFF ---------------------------------------------------------------------------------------

TEST(FloatTiff, OpenCvReadsEveryBit) {
  const TemporaryFolder folder;
  std::vector<float> values(407);
  for (std::size_t i = 0; i < values.size(); ++i) values[i] = std::sqrt(static_cast<float>(i));
  values[5] = INFINITY;
  for (const std::vector<ImageText>& texts :
       {std::vector<ImageText>{}, {{"scale", "relative"}, {"unit", "metre"}}}) {
    ASSERT_TRUE(write_float_tiff(folder.file("d.tiff"), values, 37, 11, texts));
    const cv::Mat read = cv::imread(folder.file("d.tiff"), cv::IMREAD_UNCHANGED);
    ASSERT_EQ(read.type(), CV_32F);
    ASSERT_EQ(read.size(), cv::Size(37, 11));
    EXPECT_TRUE(std::equal(values.begin(), values.end(), read.begin<float>()));
  }
  EXPECT_NE(text_of(folder.file("d.tiff")).find("scale=relative\nunit=metre\n"), std::string::npos);
}

}  // namespace
}  // namespace lcdm
