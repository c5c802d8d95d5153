// Moving values about: image to tokens and back, and resizing. No arithmetic worth vectors.
#pragma once

namespace lcdm::kernels {

// An image [height, width, channels], both sides even, and its tokens [4, height * width / 4,
// channels]: position 2 * (y % 2) + x % 2 inside a 2x2 patch, patches row by row.
struct Patches {
  int height = 0;
  int width = 0;
  int channels = 0;
};

// Copies patch rows [begin, end) of height / 2.
void unfold_rows(const Patches& patches, const float* image, float* tokens, int begin, int end);
void fold_rows(const Patches& patches, const float* tokens, float* image, int begin, int end);

// Bilinear, align_corners false, to [out_height, out_width, channels].
struct Resize {
  const float* input = nullptr;  // [in_height, in_width, channels]
  int in_height = 0;
  int in_width = 0;
  int out_height = 0;
  int out_width = 0;
  int channels = 0;
  float* output = nullptr;
};

// Computes output rows [begin, end).
void resize_rows(const Resize& resize, int begin, int end);

}  // namespace lcdm::kernels
