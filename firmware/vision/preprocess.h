// Camera pixels to the network's input: colour conversion, undistortion, resize and normalisation
// in one pass.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/buffer/frame.h"
#include "firmware/vision/axis_table.h"
#include "firmware/vision/lens_map.h"

namespace lcdm {

// Tables and scratch for one camera format and one network size. run_rows may be called by
// several workers at once, each with its own index.
class Preprocess {
 public:
  static constexpr int kMaxSide = 8192;  // of the camera's image

  // `lens_map`: of a camera model of the format's size and a view of width x height; empty: the
  // whole picture as it is. kUnsupported: MJPEG, which the pipeline decodes first; kInvalidInput:
  // impossible sizes.
  static Result<Preprocess> prepare(const FrameFormat& format, int width, int height, int workers,
                                    std::vector<CameraBox> lens_map = {});

  const FrameFormat& format() const { return format_; }

  // The frame is of the prepared format and all its bytes are there; else kInvalidInput.
  Status check(const FrameView& frame) const noexcept;

  // Writes rows [begin, end) of the network's input, (rgb / 255 - 0.45) / 0.225 as
  // [height, width, 3], from a frame that passed check(). The same values whoever computes a row.
  void run_rows(const FrameView& frame, int worker, int begin, int end, float* out) noexcept;

  // Of tables and scratch.
  std::size_t bytes() const;

 private:
  // One worker's own: camera rows as three bytes a pixel, of which neighbouring output rows share
  // most, and the rows of the output row in work.
  struct Scratch {
    std::vector<std::uint8_t> pixels;       // [slots, width * 3], and a byte
    std::vector<int> held;                  // [slots]: the camera row in each; -1: none
    std::vector<const std::uint8_t*> rows;  // [slots]
    std::vector<float> weights;             // of rows or of a box's columns
    std::vector<float> blended;             // [width * 3 + 1]
  };
  // Camera rows [begin, end).
  struct Rows {
    int begin = 0;
    int end = 0;
  };

  Preprocess() = default;
  void take_map(std::vector<CameraBox> lens_map, int height);
  void make_scratch(int workers);
  bool uses_own_rows() const;
  const std::uint8_t* camera_row(const FrameView& frame, int y, Scratch& scratch) const noexcept;
  void resize_row(const FrameView& frame, int y, Scratch& scratch, float* out) const noexcept;
  void undistort_row(const FrameView& frame, int y, Scratch& scratch, float* out) const noexcept;

  FrameFormat format_;
  int width_ = 0;
  AxisTable columns_;  // without a lens map
  AxisTable rows_;
  std::vector<CameraBox> lens_map_;  // [height, width]
  std::vector<Rows> lens_rows_;      // [height]: what a row of boxes touches
  std::size_t most_columns_ = 0;     // of a box
  std::vector<Scratch> scratch_;     // per worker
};

}  // namespace lcdm
