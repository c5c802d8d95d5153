// Camera pixels to the network's input: colour conversion, resize and normalisation in one pass.
#pragma once

#include <cstdint>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/buffer/frame.h"

namespace lcdm {

// How one axis is resampled: output i is the sum over t of weights[i * taps + t] times input
// first[i] + t. Area average when shrinking, bilinear otherwise (OpenCV's INTER_AREA and
// INTER_LINEAR, pixel centres at half integers).
struct AxisTable {
  int taps = 0;
  std::vector<int> first;
  std::vector<float> weights;
};
AxisTable make_axis_table(int in_size, int out_size);

// Tables and scratch for one camera format and one network size. run_rows may be called by
// several workers at once, each with its own index.
class Preprocess {
 public:
  static constexpr int kMaxSide = 8192;  // of the camera's image

  // kUnsupported: MJPEG, which the pipeline decodes first; kInvalidInput: impossible sizes.
  static Result<Preprocess> prepare(const FrameFormat& format, int width, int height, int workers);

  const FrameFormat& format() const { return format_; }

  // The frame is of the prepared format and all its bytes are there; else kInvalidInput.
  Status check(const FrameView& frame) const noexcept;

  // Writes rows [begin, end) of the network's input, (rgb / 255 - 0.45) / 0.225 as
  // [height, width, 3], from a frame that passed check().
  void run_rows(const FrameView& frame, int worker, int begin, int end, float* out) noexcept;

 private:
  Preprocess() = default;

  FrameFormat format_;
  int width_ = 0;
  AxisTable columns_;
  AxisTable rows_;
  std::vector<float> scratch_;  // a blended camera row, [format_.width * 3], per worker
};

}  // namespace lcdm
