// From views of a checkerboard to a camera's calibration, by OpenCV.
#pragma once

#include <string>
#include <vector>

#include "app/calibration_file.h"
#include "app/rgb_picture.h"
#include "firmware/base/status.h"
#include "firmware/vision/camera_model.h"

namespace lcdm {

// Corners between the squares: one less than squares, along each side.
struct BoardSize {
  int columns = 9;
  int rows = 6;
};

// Collects views of one board from one camera, and judges each of them and what they give.
class BoardCalibrator {
 public:
  enum class Verdict {
    kTaken,
    kNoBoard,   // not all of its corners are seen
    kTooFar,    // its squares are too small to measure
    kBlurred,   // moved, or out of focus
    kRepeated,  // nearly a view that was taken
  };
  // What a good calibration needs at least.
  static constexpr int kFewestViews = 10;
  static constexpr double kLeastCoverage = 0.6;

  BoardCalibrator(const BoardSize& board, int width, int height);

  // Looks at one picture of the camera's size.
  Verdict add(const RgbPicture& picture);

  int views() const { return static_cast<int>(corners_.size()); }
  // The share of the picture, in cells of a 4 x 4 grid, where a corner was seen in some view.
  double coverage() const;
  // Where to hold the board next, as "at the top left".
  std::string where_next() const;

  // Model, views and error. kUnavailable: the views give no calibration to rely on; the text says
  // why and what cures it.
  Result<Calibration> solve() const;

 private:
  using Corners = std::vector<Point>;  // row by row, [rows * columns]

  bool repeated(const Corners& corners) const;

  const BoardSize board_;
  const int width_;
  const int height_;
  std::vector<Corners> corners_;  // of the views taken
};

const char* to_string(BoardCalibrator::Verdict verdict);

}  // namespace lcdm
