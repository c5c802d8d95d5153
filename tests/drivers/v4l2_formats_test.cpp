// What is chosen from what a camera lists.
#include <gtest/gtest.h>
#include <string>
#include <vector>

#include "drivers/v4l2/formats.h"

namespace lcdm {
namespace {

constexpr CaptureRequest kVga{640, 480, 30, 65, {}};

V4l2Mode mode(std::uint32_t fourcc, int width, int height, std::vector<float> rates) {
  return {fourcc, width, height, width, height, std::move(rates)};
}

V4l2Choice choose(const std::vector<V4l2Mode>& modes, const CaptureRequest& request = kVga) {
  const auto choice = choose_mode(modes, request);
  EXPECT_TRUE(choice);
  return choice.value_or(V4l2Choice{});
}

TEST(V4l2Formats, WhatNeedsNoDecodingWins) {
  const V4l2Choice choice = choose(
      {mode(V4L2_PIX_FMT_MJPEG, 640, 480, {30}), mode(V4L2_PIX_FMT_YUYV, 640, 480, {30, 15})});
  EXPECT_EQ(choice.pixel, PixelFormat::kYuyv);
  EXPECT_EQ(choice.reason, "over MJPEG: needs no decoding");
}

TEST(V4l2Formats, TheRateCountsMoreThanDecoding) {
  const V4l2Choice choice =
      choose({mode(V4L2_PIX_FMT_YUYV, 640, 480, {10}), mode(V4L2_PIX_FMT_MJPEG, 640, 480, {30})});
  EXPECT_EQ(choice.pixel, PixelFormat::kMjpeg);
  EXPECT_EQ(choice.reason, "over YUYV: reaches the rate");
}

TEST(V4l2Formats, ARateThatIsNearlyReachedIsReached) {
  EXPECT_EQ(choose({mode(V4L2_PIX_FMT_YUYV, 640, 480, {29.97F}),
                    mode(V4L2_PIX_FMT_MJPEG, 640, 480, {30})})
                .pixel,
            PixelFormat::kYuyv);
}

TEST(V4l2Formats, TheSizeCountsMoreThanTheRate) {
  const CaptureRequest full_hd{1920, 1080, 30, 65, {}};
  const V4l2Choice choice =
      choose({mode(V4L2_PIX_FMT_YUYV, 640, 480, {30}), mode(V4L2_PIX_FMT_MJPEG, 640, 480, {30}),
              mode(V4L2_PIX_FMT_MJPEG, 1920, 1080, {15})},
             full_hd);
  EXPECT_EQ(choice.pixel, PixelFormat::kMjpeg);
  EXPECT_EQ(choice.width, 1920);
  EXPECT_EQ(choice.reason, "over YUYV: nearer to the size asked for");
}

TEST(V4l2Formats, OfEachFormatTheNearestSizeIsTaken) {
  const V4l2Choice choice =
      choose({mode(V4L2_PIX_FMT_YUYV, 320, 240, {30}), mode(V4L2_PIX_FMT_YUYV, 800, 600, {30}),
              mode(V4L2_PIX_FMT_YUYV, 1920, 1080, {30})});
  EXPECT_EQ(choice.width, 800);
  EXPECT_EQ(choice.height, 600);
}

TEST(V4l2Formats, ARangeOfSizesIsMetByTheRequest) {
  const V4l2Choice choice = choose({{V4L2_PIX_FMT_NV12, 16, 16, 4096, 2160, {}}});
  EXPECT_EQ(choice.width, 640);
  EXPECT_EQ(choice.height, 480);
}

TEST(V4l2Formats, ARangeInStepsIsMetAtTheNearestStep) {
  const V4l2Mode steps{V4L2_PIX_FMT_NV12, 32, 32, 1000, 1000, {}, 60, 16};
  EXPECT_EQ(choose({steps}).width, 632) << "32 + 10 * 60";
  EXPECT_EQ(choose({steps}).height, 480);
  const CaptureRequest huge{4000, 8, 30, 65, {}};
  EXPECT_EQ(choose({steps}, huge).width, 992) << "the last step within the range";
  EXPECT_EQ(choose({steps}, huge).height, 32);
}

TEST(V4l2Formats, WithoutListedSizesTheDriverIsAskedForTheRequest) {
  EXPECT_EQ(choose({mode(V4L2_PIX_FMT_YUYV, 0, 0, {})}).width, 640);
}

TEST(V4l2Formats, FewerBytesWinAmongEquals) {
  const V4l2Choice choice =
      choose({mode(V4L2_PIX_FMT_RGB24, 640, 480, {30}), mode(V4L2_PIX_FMT_YUYV, 640, 480, {30}),
              mode(V4L2_PIX_FMT_NV12, 640, 480, {30})});
  EXPECT_EQ(choice.pixel, PixelFormat::kNv12);
  EXPECT_EQ(choice.reason, "over YUYV: fewest bytes");
}

TEST(V4l2Formats, ColourWinsOverGreyEvenWhenItMustBeDecoded) {
  const V4l2Choice choice =
      choose({mode(V4L2_PIX_FMT_GREY, 640, 480, {30}), mode(V4L2_PIX_FMT_MJPEG, 640, 480, {30})});
  EXPECT_EQ(choice.pixel, PixelFormat::kMjpeg);
  EXPECT_EQ(choice.reason, "over GREY: has colour");
  EXPECT_EQ(choose({mode(V4L2_PIX_FMT_GREY, 640, 480, {30})}).pixel, PixelFormat::kGrey);
}

TEST(V4l2Formats, AnOnlyFormatNeedsNoReason) {
  EXPECT_EQ(choose({mode(V4L2_PIX_FMT_UYVY, 640, 480, {})}).reason, "");
}

TEST(V4l2Formats, ANamedFormatIsTakenWhateverItCosts) {
  const std::vector<V4l2Mode> modes = {mode(V4L2_PIX_FMT_NV12, 640, 480, {30}),
                                       mode(V4L2_PIX_FMT_MJPEG, 640, 480, {15})};
  CaptureRequest request = kVga;
  request.format = PixelFormat::kMjpeg;
  EXPECT_EQ(choose_mode(modes, request)->pixel, PixelFormat::kMjpeg);
  EXPECT_EQ(choose_mode(modes, request)->reason, "");
  request.format = PixelFormat::kGrey;
  EXPECT_FALSE(choose_mode(modes, request));
}

TEST(V4l2Formats, UnknownFormatsAreNoChoice) {
  EXPECT_FALSE(choose_mode(
      {mode(V4L2_PIX_FMT_SRGGB10, 640, 480, {30}), mode(V4L2_PIX_FMT_NV12M, 640, 480, {30})},
      kVga));
  EXPECT_FALSE(choose_mode({}, kVga));
}

TEST(V4l2Formats, NamesAreReadable) {
  EXPECT_EQ(fourcc_text(V4L2_PIX_FMT_YUYV), "YUYV");
  EXPECT_EQ(fourcc_text(V4L2_PIX_FMT_Y16), "Y16");
  EXPECT_EQ(fourcc_text(0x01020304), "????");
}

}  // namespace
}  // namespace lcdm
