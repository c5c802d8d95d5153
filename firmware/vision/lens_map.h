// Taking a lens's distortion away: which pinhole view to show, and where the camera saw it.
#pragma once

#include <algorithm>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/vision/camera_model.h"

namespace lcdm {

// A part of an axis of the camera's picture, in pixels from its edge: pixel i is from i to i + 1.
struct Stretch {
  float begin = 0;
  float length = 0;

  // It touches the pixels [first(), last(limit)) of `limit`.
  int first() const { return static_cast<int>(begin); }
  int last(int limit) const { return std::min(static_cast<int>(begin + length) + 1, limit); }
  // How much of pixel `i` it covers.
  float share(int i) const {
    const auto edge = static_cast<float>(i);
    return std::max(0.0F, std::min(begin + length, edge + 1) - std::max(begin, edge));
  }
};

// What a pixel of the network's input shows of the camera's picture.
struct CameraBox {
  Stretch columns;
  Stretch rows;
};

// The pinhole view that a network's input of width x height shows: the camera's whole picture, each
// axis by its own factor; where the lens distorts, the largest cut of the undistorted picture that
// has no empty corner, of the same pixel shape. kInvalidInput: a lens model that folds the picture.
Result<CameraModel> pinhole_view(const CameraModel& camera, int width, int height);

// For each pixel of `view`, row by row, the box of the camera's picture to average: as large as the
// pixel where the view shrinks the picture, else a camera pixel, whose average is bilinear
// interpolation. kInvalidInput: as above.
Result<std::vector<CameraBox>> make_lens_map(const CameraModel& camera, const CameraModel& view);

}  // namespace lcdm
