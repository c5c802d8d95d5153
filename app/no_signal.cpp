#include "app/no_signal.h"

#include <algorithm>
#include <cstdio>
#include <opencv2/imgproc.hpp>

#include "app/rgb_picture.h"
#include "drivers/codec/codec.h"

namespace lcdm {
namespace {

constexpr int kWidth = 640;  // where there was no picture yet
constexpr int kHeight = 480;
constexpr int kDim = 3;  // so many times darker than it was

// Black where `jpeg` is none.
RgbPicture decode_or_black(std::span<const std::byte> jpeg) {
  const std::span bytes(reinterpret_cast<const std::uint8_t*>(jpeg.data()), jpeg.size());
  const Result<FrameFormat> format = JpegDecoder::format_of(bytes);
  RgbPicture picture;
  picture.resize(format ? format->width : kWidth, format ? format->height : kHeight);
  if (!format) return picture;
  JpegDecoder decoder;
  Status status = decoder.prepare(picture.width, picture.height);
  if (status) status = decoder.decode(bytes, picture.pixels);
  if (!status) std::fill(picture.pixels.begin(), picture.pixels.end(), std::uint8_t{0});
  return picture;
}

void dim(RgbPicture& picture) {
  for (std::size_t i = 0; i < picture.pixels.size(); i += 3) {
    const int sum = picture.pixels[i] + picture.pixels[i + 1] + picture.pixels[i + 2];
    std::fill_n(&picture.pixels[i], 3, static_cast<std::uint8_t>(sum / (3 * kDim)));
  }
}

// Over nine tenths of the width.
void write_across(RgbPicture& picture, const std::string& text) {
  constexpr int kFont = cv::FONT_HERSHEY_SIMPLEX;
  cv::Mat pixels(picture.height, picture.width, CV_8UC3, picture.pixels.data());
  const cv::Size unscaled = cv::getTextSize(text, kFont, 1, 1, nullptr);
  const double scale = 0.9 * picture.width / unscaled.width;
  const int thickness = std::max(1, picture.width / 320);
  cv::putText(pixels, text, {picture.width / 20, picture.height / 2}, kFont, scale,
              cv::Scalar::all(255), thickness, cv::LINE_AA);
}

}  // namespace

std::string no_signal_text(std::int64_t age_ns) {
  if (age_ns < 0) return "no signal";
  char text[64];
  std::snprintf(text, sizeof(text), "no signal, last frame %.0f s ago",
                static_cast<double>(age_ns) * 1e-9);
  return text;
}

std::vector<std::byte> no_signal_jpeg(std::span<const std::byte> last, std::int64_t age_ns) {
  RgbPicture picture = decode_or_black(last);
  dim(picture);
  write_across(picture, no_signal_text(age_ns));
  JpegWriter writer(kStreamedQuality);
  const Result<std::span<const std::byte>> jpeg = writer.encode(picture.view());
  return jpeg ? std::vector<std::byte>(jpeg->begin(), jpeg->end()) : std::vector<std::byte>();
}

}  // namespace lcdm
