// Pictures as bytes: JPEG in both directions, depth as 16-bit PNG, floats as TIFF.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/buffer/frame.h"

namespace lcdm {

// ---- JPEG (ITU-T T.81, baseline) ----------------------------------------------------------------

// Of pictures that are streamed, and of those that are kept: artefacts would be learned.
constexpr int kStreamedQuality = 85;
constexpr int kKeptQuality = 92;

// Room for the JPEG of a picture, though it be noise and as small as the tables in front.
std::size_t jpeg_capacity(const FrameFormat& format);

// For one thread at a time. prepare() allocates what every frame then uses; encode() allocates
// nothing.
class JpegEncoder {
 public:
  JpegEncoder();
  ~JpegEncoder();
  JpegEncoder(JpegEncoder&&) noexcept;
  JpegEncoder& operator=(JpegEncoder&&) noexcept;

  // For frames of `format` (any but kMjpeg). `quality` from 1 to 100.
  Status prepare(const FrameFormat& format, int quality);
  // Writes one JPEG to the front of `out` and returns its length. kInvalidInput: the frame has
  // another format or lacks bytes. kOutOfMemory: `out` is too small: `jpeg_capacity` is enough.
  Result<std::size_t> encode(const FrameView& frame, std::span<std::byte> out) noexcept;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

// A JpegEncoder that prepares itself for whatever format comes, with memory of its own. For one
// thread at a time.
class JpegWriter {
 public:
  explicit JpegWriter(int quality) : quality_(quality) {}

  // The bytes are valid until the next call.
  Result<std::span<const std::byte>> encode(const FrameView& frame);

 private:
  const int quality_;
  JpegEncoder encoder_;
  FrameFormat format_;  // that it is prepared for
  std::vector<std::byte> bytes_;
};

// For one thread at a time. prepare() allocates what every frame then uses; decode() allocates
// nothing.
class JpegDecoder {
 public:
  JpegDecoder();
  ~JpegDecoder();
  JpegDecoder(JpegDecoder&&) noexcept;
  JpegDecoder& operator=(JpegDecoder&&) noexcept;

  // A picture's size by its header, as the format of a Motion-JPEG frame. kCorrupt: no JPEG.
  static Result<FrameFormat> format_of(std::span<const std::uint8_t> jpeg);

  Status prepare(int width, int height);
  // `jpeg`: untrusted; Motion-JPEG frames without Huffman tables are understood. `rgb`: the
  // prepared height * width * 3 bytes. kCorrupt: broken, cut short or of another size; what is then
  // in `rgb` is not a picture. kUnsupported: progressive or neither grey nor colour.
  Status decode(std::span<const std::uint8_t> jpeg, std::span<std::uint8_t> rgb) noexcept;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

// ---- PNG (ISO/IEC 15948) and TIFF 6.0 -----------------------------------------------------------

// What a file says about itself: such as scale, source, unit. Latin-1 text; keys of 1 to 79
// characters.
struct ImageText {
  std::string key;
  std::string value;
};

// Depth as 16-bit greyscale, [height][width]; the texts become tEXt chunks.
Status encode_depth_png(std::span<const std::uint16_t> millimetres, int width, int height,
                        std::span<const ImageText> texts, std::vector<std::byte>& out);
Status write_depth_png(const std::string& path, std::span<const std::uint16_t> millimetres,
                       int width, int height, std::span<const ImageText> texts = {});

struct DepthImage {
  int width = 0;
  int height = 0;
  std::vector<std::uint16_t> values;  // [height][width]
};

// Any 16-bit greyscale PNG of at most 64 Mpixel; untrusted.
Result<DepthImage> read_depth_png(const std::string& path);

// Colour, [height][width][3].
Status write_rgb_png(const std::string& path, std::span<const std::uint8_t> rgb, int width,
                     int height);

// 32-bit floats, [height][width], uncompressed; the texts become one ImageDescription, a
// "key=value" per line.
Status write_float_tiff(const std::string& path, std::span<const float> values, int width,
                        int height, std::span<const ImageText> texts = {});

}  // namespace lcdm
