#include "firmware/buffer/frame.h"

namespace lcdm {

const char* to_string(PixelFormat pixel) {
  switch (pixel) {
    case PixelFormat::kRgb24:
      return "RGB24";
    case PixelFormat::kBgr24:
      return "BGR24";
    case PixelFormat::kYuyv:
      return "YUYV";
    case PixelFormat::kMjpeg:
      return "MJPEG";
  }
  return "unknown";
}

int packed_stride(PixelFormat pixel, int width) {
  switch (pixel) {
    case PixelFormat::kRgb24:
    case PixelFormat::kBgr24:
      return width * 3;
    case PixelFormat::kYuyv:
      return width * 2;
    case PixelFormat::kMjpeg:
      return 0;
  }
  return 0;
}

}  // namespace lcdm
