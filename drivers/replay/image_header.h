// Whether a picture can be decoded: its header read before a decoder takes memory for it.
#pragma once

#include <cstdint>
#include <span>

namespace lcdm::replay {

// What keeps these bytes from being decoded as a JPEG, PNG, BMP or TIFF: another format, a size
// beyond 100 megapixels or 8192 pixels, or (JPEG, PNG) an end that is missing, which decoders would
// fill with grey. Null: nothing.
const char* image_fault(std::span<const std::uint8_t> bytes);

}  // namespace lcdm::replay
