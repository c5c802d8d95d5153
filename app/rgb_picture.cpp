#include "app/rgb_picture.h"

#include <algorithm>
#include <cstring>

#include "firmware/base/check.h"

namespace lcdm {
namespace {

constexpr std::size_t kChannels = 3;

std::uint8_t to_byte(int fixed) {
  return static_cast<std::uint8_t>(std::clamp(fixed >> 8, 0, 255));
}

// BT.601, limited range, in 8-bit fixed point.
void yuv_to_rgb(int y, int u, int v, std::uint8_t* rgb) {
  const int luma = 298 * std::max(0, y - 16) + 128;
  rgb[0] = to_byte(luma + 409 * (v - 128));
  rgb[1] = to_byte(luma - 100 * (u - 128) - 208 * (v - 128));
  rgb[2] = to_byte(luma + 516 * (u - 128));
}

void convert_row(const std::uint8_t* in, PixelFormat format, int width, std::uint8_t* out) {
  switch (format) {
    case PixelFormat::kRgb24:
      std::memcpy(out, in, static_cast<std::size_t>(width) * kChannels);
      return;
    case PixelFormat::kBgr24:
      for (int x = 0; x < width; ++x, in += 3, out += 3) {
        out[0] = in[2];
        out[1] = in[1];
        out[2] = in[0];
      }
      return;
    case PixelFormat::kYuyv:
      for (int x = 0; x < width; ++x, out += 3) {  // Y0 U Y1 V
        const int second = x % 2;
        yuv_to_rgb(in[second == 0 ? 0 : 2], in[1], in[3], out);
        if (second == 1) in += 4;
      }
      return;
    case PixelFormat::kMjpeg:
      break;
  }
  LCDM_CHECK(!"a compressed frame has no rows");
}

}  // namespace

void RgbPicture::resize(int new_width, int new_height) {
  width = new_width;
  height = new_height;
  pixels.resize(static_cast<std::size_t>(width) * static_cast<std::size_t>(height) * kChannels);
}

void to_rgb(const FrameView& frame, RgbPicture& out) {
  const FrameFormat& format = frame.format;
  out.resize(format.width, format.height);
  const auto stride = static_cast<std::size_t>(format.stride);
  const std::size_t row = static_cast<std::size_t>(format.width) * kChannels;
  for (std::size_t y = 0; y < static_cast<std::size_t>(format.height); ++y) {
    convert_row(frame.data + y * stride, format.pixel, format.width, &out.pixels[y * row]);
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
