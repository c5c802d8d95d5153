// Camera pixels to the network's input: colour conversion, resize and normalisation in one pass.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/buffer/frame.h"
#include "firmware/vision/axis_table.h"

namespace lcdm {

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
  // [height, width, 3], from a frame that passed check(). The same values whoever computes a row.
  void run_rows(const FrameView& frame, int worker, int begin, int end, float* out) noexcept;

 private:
  // One worker's own: camera rows as RGB, of which neighbouring output rows share some, and the
  // row they are blended into.
  struct Scratch {
    std::vector<std::uint8_t> rgb;          // [rows_.taps, width * 3]; none where bytes are RGB
    std::vector<int> held;                  // the camera row in each slot of `rgb`; -1: none
    std::vector<const std::uint8_t*> taps;  // [rows_.taps]
    std::vector<float> weights;             // [rows_.taps]
    std::vector<float> blended;             // [width * 3 + 1]
  };

  Preprocess() = default;
  const std::uint8_t* camera_row(const FrameView& frame, int y, Scratch& scratch) const noexcept;

  FrameFormat format_;
  int width_ = 0;
  AxisTable columns_;
  AxisTable rows_;
  std::vector<Scratch> scratch_;  // per worker
};

}  // namespace lcdm
