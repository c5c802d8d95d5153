// Camera pixels as RGB24, and small operations on such pictures.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "firmware/buffer/frame.h"

namespace lcdm {

// Rows packed, three bytes a pixel.
struct RgbPicture {
  int width = 0;
  int height = 0;
  std::vector<std::uint8_t> pixels;  // [height * width * 3]

  void resize(int new_width, int new_height);
  FrameView view() const;
};

// Any format but kMjpeg. `frame` must hold its whole picture.
void to_rgb(const FrameView& frame, RgbPicture& out);

// `right`, resized to the size of `left` by nearest neighbour, beside `left`.
void put_side_by_side(const RgbPicture& left, const RgbPicture& right, RgbPicture& out);

}  // namespace lcdm
