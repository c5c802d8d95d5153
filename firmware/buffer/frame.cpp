#include "firmware/buffer/frame.h"

#include "firmware/base/check.h"

namespace lcdm {
namespace {

// Chroma has rows of its own, below those of luma.
bool has_chroma_rows(PixelFormat pixel) {
  return pixel == PixelFormat::kNv12 || pixel == PixelFormat::kNv21;
}

}  // namespace

const char* to_string(PixelFormat pixel) {
  switch (pixel) {
    case PixelFormat::kRgb24:
      return "RGB24";
    case PixelFormat::kBgr24:
      return "BGR24";
    case PixelFormat::kYuyv:
      return "YUYV";
    case PixelFormat::kUyvy:
      return "UYVY";
    case PixelFormat::kNv12:
      return "NV12";
    case PixelFormat::kNv21:
      return "NV21";
    case PixelFormat::kGrey:
      return "GREY";
    case PixelFormat::kMjpeg:
      return "MJPEG";
  }
  return "unknown";
}

std::optional<PixelFormat> parse_pixel_format(std::string_view name) {
  for (int i = 0; i <= static_cast<int>(PixelFormat::kMjpeg); ++i) {
    const auto pixel = static_cast<PixelFormat>(i);
    if (name == to_string(pixel)) return pixel;
  }
  return std::nullopt;
}

int packed_stride(PixelFormat pixel, int width) {
  switch (pixel) {
    case PixelFormat::kRgb24:
    case PixelFormat::kBgr24:
      return width * 3;
    case PixelFormat::kYuyv:
    case PixelFormat::kUyvy:
      return width * 2;
    case PixelFormat::kNv12:
    case PixelFormat::kNv21:
    case PixelFormat::kGrey:
      return width;
    case PixelFormat::kMjpeg:
      return 0;
  }
  return 0;
}

bool is_picture(const FrameFormat& format) {
  if (format.pixel == PixelFormat::kMjpeg || format.width <= 0 || format.height <= 0) return false;
  if (is_yuv(format.pixel) && format.width % 2 != 0) return false;
  if (has_chroma_rows(format.pixel) && format.height % 2 != 0) return false;
  return format.stride >= packed_stride(format.pixel, format.width);
}

std::size_t picture_bytes(const FrameFormat& format) {
  const auto height = static_cast<std::size_t>(format.height);
  const std::size_t rows = has_chroma_rows(format.pixel) ? height + height / 2 : height;
  return (rows - 1) * static_cast<std::size_t>(format.stride) +
         static_cast<std::size_t>(packed_stride(format.pixel, format.width));
}

bool is_yuv(PixelFormat pixel) {
  return pixel == PixelFormat::kYuyv || pixel == PixelFormat::kUyvy || has_chroma_rows(pixel);
}

YuvRow yuv_row(const FrameView& frame, int y) {
  const auto stride = static_cast<std::size_t>(frame.format.stride);
  const std::uint8_t* row = frame.data + static_cast<std::size_t>(y) * stride;
  const std::uint8_t* chroma =
      frame.data + static_cast<std::size_t>(frame.format.height + y / 2) * stride;
  switch (frame.format.pixel) {
    case PixelFormat::kYuyv:
      return {row, row + 1, row + 3, 2, 4};
    case PixelFormat::kUyvy:
      return {row + 1, row, row + 2, 2, 4};
    case PixelFormat::kNv12:
      return {row, chroma, chroma + 1, 1, 2};
    case PixelFormat::kNv21:
      return {row, chroma + 1, chroma, 1, 2};
    default:
      break;
  }
  LCDM_CHECK(!"not a YUV picture");
  return {};
}

}  // namespace lcdm
