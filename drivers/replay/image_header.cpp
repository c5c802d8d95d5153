#include "drivers/replay/image_header.h"

#include <algorithm>
#include <cstddef>
#include <cstdlib>

namespace lcdm::replay {
namespace {

using Bytes = std::span<const std::uint8_t>;

constexpr std::uint64_t kMaxPixels = 100'000'000;
constexpr std::uint64_t kMaxSide = 8192;  // as the engine's pre-processing
constexpr const char* kCut = "it is cut short";

std::uint32_t big_endian(Bytes bytes) {
  std::uint32_t value = 0;
  for (const std::uint8_t byte : bytes) value = value << 8 | byte;
  return value;
}

std::uint32_t little_endian(Bytes bytes) {
  std::uint32_t value = 0;
  for (std::size_t i = bytes.size(); i-- > 0;) value = value << 8 | bytes[i];
  return value;
}

const char* size_fault(std::uint64_t width, std::uint64_t height) {
  if (width == 0 || height == 0) return "it has no size";
  if (width > kMaxSide || height > kMaxSide) return "a side is longer than 8192 pixels";
  return width * height > kMaxPixels ? "it has over 100 megapixels" : nullptr;
}

// Walks the marker segments (ITU-T T.81, B.1) to the end of the image.
const char* jpeg_fault(Bytes bytes) {
  std::size_t at = 2;
  while (true) {
    // Entropy-coded data, fill bytes and stuffed or restart markers lie between segments.
    while (at + 1 < bytes.size() &&
           (bytes[at] != 0xFF || bytes[at + 1] == 0 || bytes[at + 1] == 0xFF ||
            (bytes[at + 1] >= 0xD0 && bytes[at + 1] <= 0xD7))) {
      ++at;
    }
    if (at + 1 >= bytes.size()) return kCut;
    const std::uint8_t marker = bytes[at + 1];
    at += 2;
    if (marker == 0xD9) return nullptr;
    if (at + 2 > bytes.size()) return kCut;
    const std::uint32_t length = big_endian(bytes.subspan(at, 2));
    if (at + length > bytes.size()) return kCut;
    const bool frame =
        marker >= 0xC0 && marker <= 0xCF && marker != 0xC4 && marker != 0xC8 && marker != 0xCC;
    if (frame && length >= 7) {
      const char* fault =
          size_fault(big_endian(bytes.subspan(at + 5, 2)), big_endian(bytes.subspan(at + 3, 2)));
      if (fault != nullptr) return fault;
    }
    at += std::max<std::uint32_t>(length, 2);
  }
}

// Walks the chunks (ISO/IEC 15948, 5.3) to IEND.
const char* png_fault(Bytes bytes) {
  constexpr std::size_t kSignature = 8;
  constexpr std::size_t kAround = 12;  // length, type and checksum of a chunk
  if (bytes.size() < kSignature + kAround + 13) return kCut;
  const char* fault =
      size_fault(big_endian(bytes.subspan(16, 4)), big_endian(bytes.subspan(20, 4)));
  if (fault != nullptr) return fault;
  std::size_t at = kSignature;
  while (at + kAround <= bytes.size()) {
    const std::size_t length = big_endian(bytes.subspan(at, 4));
    const bool end = big_endian(bytes.subspan(at + 4, 4)) == 0x49454E44;  // "IEND"
    at += kAround + length;
    if (end && at <= bytes.size()) return nullptr;
  }
  return kCut;
}

// The header's second part begins with its length: 12 is OS/2's, with sides of 16 bits.
const char* bmp_fault(Bytes bytes) {
  if (bytes.size() < 26) return kCut;
  if (little_endian(bytes.subspan(14, 4)) == 12) {
    return size_fault(little_endian(bytes.subspan(18, 2)), little_endian(bytes.subspan(20, 2)));
  }
  const auto height = static_cast<std::int32_t>(little_endian(bytes.subspan(22, 4)));
  return size_fault(little_endian(bytes.subspan(18, 4)),  // from the top where it is negative
                    static_cast<std::uint64_t>(std::abs(static_cast<std::int64_t>(height))));
}

// The first directory's ImageWidth and ImageLength (TIFF 6.0, section 2); of several the largest,
// since decoders differ in which they take.
const char* tiff_fault(Bytes bytes) {
  constexpr std::size_t kEntry = 12;
  const auto number = bytes[0] == 'I' ? little_endian : big_endian;
  if (bytes.size() < 8) return kCut;
  const std::size_t directory = number(bytes.subspan(4, 4));
  if (directory > bytes.size() - 2) return kCut;
  std::uint64_t width = 0;
  std::uint64_t height = 0;
  std::size_t at = directory + 2;
  for (std::uint32_t left = number(bytes.subspan(directory, 2)); left > 0; --left, at += kEntry) {
    if (at + kEntry > bytes.size()) return kCut;
    const bool is_short = number(bytes.subspan(at + 2, 2)) == 3;
    const std::uint32_t value = number(bytes.subspan(at + 8, is_short ? 2 : 4));
    const std::uint32_t tag = number(bytes.subspan(at, 2));
    if (tag == 256) width = std::max<std::uint64_t>(width, value);
    if (tag == 257) height = std::max<std::uint64_t>(height, value);
  }
  return size_fault(width, height);
}

}  // namespace

const char* image_fault(Bytes bytes) {
  if (bytes.size() < 4) return kCut;
  const std::uint32_t magic = big_endian(bytes.first(4));
  if (magic >> 16 == 0xFFD8) return jpeg_fault(bytes);
  if (magic == 0x89504E47) return png_fault(bytes);
  if (magic >> 16 == 0x424D) return bmp_fault(bytes);                        // "BM"
  if (magic == 0x49492A00 || magic == 0x4D4D002A) return tiff_fault(bytes);  // "II*", "MM*"
  return "it is no JPEG, PNG, BMP or TIFF";
}

}  // namespace lcdm::replay
