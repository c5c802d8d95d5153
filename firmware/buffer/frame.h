// What a camera delivers: pixels in the camera's own format, borrowed for a while, with their
// stamp.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string_view>

namespace lcdm {

// YUV is BT.601 with limited range, a pair of neighbours sharing its U and V, so widths are even.
enum class PixelFormat : std::uint8_t {
  kRgb24,
  kBgr24,
  kYuyv,   // 4:2:2 packed, Y0 U Y1 V
  kUyvy,   // 4:2:2 packed, U Y0 V Y1
  kNv12,   // 4:2:0, rows of Y, then half as many rows of U V U V ..., all `stride` apart; even
           // height
  kNv21,   // as kNv12 with V U V U ...
  kGrey,   // 8 bits, full range
  kMjpeg,  // one JPEG per frame; FrameView::bytes is its length, stride is 0
};

const char* to_string(PixelFormat pixel);
// By that name; null for any other text.
std::optional<PixelFormat> parse_pixel_format(std::string_view name);

struct FrameFormat {
  PixelFormat pixel = PixelFormat::kRgb24;
  int width = 0;   // pixels
  int height = 0;  // pixels
  int stride = 0;  // bytes from one row to the next; 0 for kMjpeg

  bool operator==(const FrameFormat&) const = default;
};

// Bytes per row without padding; of kNv12 and kNv21 both kinds of row. 0 for kMjpeg.
int packed_stride(PixelFormat pixel, int width);

// Whether a picture can look like this: sides positive, and even where chroma is shared; rows at
// least as far apart as they are long. False for kMjpeg, whose pixels nobody knows yet.
bool is_picture(const FrameFormat& format);

// Bytes from a picture's first to its last, behind which the last row's padding may be missing.
std::size_t picture_bytes(const FrameFormat& format);

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

// Where a row of a YUV picture lies: the pair i has its luma at luma[2 * i * luma_step] and
// luma[(2 * i + 1) * luma_step], its chroma at u[i * chroma_step] and v[i * chroma_step].
struct YuvRow {
  const std::uint8_t* luma = nullptr;
  const std::uint8_t* u = nullptr;
  const std::uint8_t* v = nullptr;
  int luma_step = 0;    // bytes
  int chroma_step = 0;  // bytes
};

bool is_yuv(PixelFormat pixel);
// Row `y` of a picture that is_yuv.
YuvRow yuv_row(const FrameView& frame, int y);

}  // namespace lcdm
