// What a camera delivers: pixels in the camera's own format, borrowed for a while, with their
// stamp.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace lcdm {

enum class PixelFormat : std::uint8_t {
  kRgb24,
  kBgr24,
  kYuyv,   // 4:2:2 packed, Y0 U Y1 V, BT.601 limited range
  kMjpeg,  // one JPEG per frame; FrameView::bytes is its length, stride is 0
};

const char* to_string(PixelFormat pixel);

struct FrameFormat {
  PixelFormat pixel = PixelFormat::kRgb24;
  int width = 0;   // pixels
  int height = 0;  // pixels
  int stride = 0;  // bytes from one row to the next; 0 for kMjpeg

  bool operator==(const FrameFormat&) const = default;
};

// Bytes per row without padding; 0 for kMjpeg.
int packed_stride(PixelFormat pixel, int width);

struct FrameMeta {
  std::uint64_t sequence = 0;  // counts up by 1; a gap means the source lost frames
  std::int64_t sensor_ns = 0;  // CLOCK_MONOTONIC, when the sensor delivered the frame
  std::int64_t unix_ns = 0;    // the same instant as Unix time, for formats that mean Unix time
};

// A frame on loan: whoever hands it out says how long it stays valid.
struct FrameView {
  FrameFormat format;
  FrameMeta meta;
  const std::uint8_t* data = nullptr;
  std::size_t bytes = 0;  // valid bytes at data
};

}  // namespace lcdm
