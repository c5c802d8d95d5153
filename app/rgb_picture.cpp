#include "app/rgb_picture.h"

#include <cstring>

#include "firmware/vision/rgb_row.h"

namespace lcdm {
namespace {

constexpr std::size_t kChannels = 3;

}  // namespace

void RgbPicture::resize(int new_width, int new_height) {
  width = new_width;
  height = new_height;
  pixels.resize(static_cast<std::size_t>(width) * static_cast<std::size_t>(height) * kChannels);
}

FrameView RgbPicture::view() const {
  const FrameFormat format{PixelFormat::kRgb24, width, height, width * static_cast<int>(kChannels)};
  return {format, {}, pixels.data(), pixels.size()};
}

void to_rgb(const FrameView& frame, RgbPicture& out) {
  out.resize(frame.format.width, frame.format.height);
  const std::size_t row = static_cast<std::size_t>(out.width) * kChannels;
  for (int y = 0; y < out.height; ++y) {
    rgb_row(frame, y, &out.pixels[static_cast<std::size_t>(y) * row]);
  }
}

void put_side_by_side(const RgbPicture& left, const RgbPicture& right, RgbPicture& out) {
  out.resize(left.width * 2, left.height);
  const auto width = static_cast<std::size_t>(left.width);
  for (std::size_t y = 0; y < static_cast<std::size_t>(left.height); ++y) {
    std::uint8_t* row = &out.pixels[y * width * 2 * kChannels];
    std::memcpy(row, &left.pixels[y * width * kChannels], width * kChannels);
    row += width * kChannels;
    const std::size_t source_y =
        y * static_cast<std::size_t>(right.height) / static_cast<std::size_t>(left.height);
    const auto right_width = static_cast<std::size_t>(right.width);
    const std::uint8_t* source = &right.pixels[source_y * right_width * kChannels];
    for (std::size_t x = 0; x < width; ++x, row += kChannels) {
      std::memcpy(row, source + x * right_width / width * kChannels, kChannels);
    }
  }
}

}  // namespace lcdm
