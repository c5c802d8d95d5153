// Pinhole intrinsics of an image: of the camera's own, or of the network's input cut from it.
#pragma once

namespace lcdm {

// Pixels; the centre of the top-left pixel is (0, 0).
struct CameraModel {
  int width = 0;
  int height = 0;
  float fx = 0;
  float fy = 0;
  float cx = 0;
  float cy = 0;
  bool calibrated = false;  // false: fx, fy come from an assumed field of view

  // The model of the same view resized to width x height (each axis by its own factor).
  CameraModel resized(int new_width, int new_height) const;

  // A centred model with square pixels from a horizontal field of view; not calibrated.
  static CameraModel from_field_of_view(int width, int height, float horizontal_degrees);
};

}  // namespace lcdm
