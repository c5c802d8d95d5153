// Pinhole intrinsics of an image: of the camera's own, or of the network's input cut from it.
#pragma once

#include <array>
#include <optional>

namespace lcdm {

// A place in an image in pixels, or a ray (x, y, 1) of the camera.
struct Point {
  double x = 0;
  double y = 0;
};

// Pixels; the centre of the top-left pixel is (0, 0).
struct CameraModel {
  int width = 0;
  int height = 0;
  float fx = 0;
  float fy = 0;
  float cx = 0;
  float cy = 0;
  bool calibrated = false;  // false: fx, fy come from an assumed field of view
  // The lens: k1, k2, p1, p2, k3, and k4, k5, k6 below the line, in OpenCV's order and meaning
  // (calib3d); all 0 for a pinhole's picture.
  std::array<float, 8> distortion = {};

  bool operator==(const CameraModel&) const = default;

  bool distorted() const { return distortion != std::array<float, 8>{}; }

  // Where the ray (ray.x, ray.y, 1) is seen, through the lens.
  Point project(const Point& ray) const;
  // The ray seen at `pixel`; none where the lens model cannot be inverted.
  std::optional<Point> unproject(const Point& pixel) const;

  // Whether pictures of this size can show the same view: their sides are in the same proportion,
  // to half a percent.
  bool has_shape(int other_width, int other_height) const;
  // The model of the same view resized to width x height (each axis by its own factor).
  CameraModel resized(int new_width, int new_height) const;

  // A centred model with square pixels from a horizontal field of view; not calibrated.
  static CameraModel from_field_of_view(int width, int height, float horizontal_degrees);
};

}  // namespace lcdm
