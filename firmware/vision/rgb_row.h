// Camera pixels as RGB, a row at a time.
#pragma once

#include <cstdint>

#include "firmware/buffer/frame.h"

namespace lcdm {

// Writes row `y` of a picture (is_picture) as width * 3 bytes. YUV by ITU-R BT.601 with limited
// range, both pixels of a pair and both rows over a row of chroma with the same chroma; each value
// within 0.6 of the exact one, the same on every instruction set.
void rgb_row(const FrameView& frame, int y, std::uint8_t* out) noexcept;

}  // namespace lcdm
