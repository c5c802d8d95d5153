#include "firmware/vision/camera_model.h"

#include <cmath>

namespace lcdm {

Point CameraModel::project(const Point& ray) const {
  const auto& [k1, k2, p1, p2, k3, k4, k5, k6] = distortion;
  const auto [x, y] = ray;
  const double r2 = x * x + y * y;
  const double radial =
      (1 + r2 * (k1 + r2 * (k2 + r2 * double{k3}))) / (1 + r2 * (k4 + r2 * (k5 + r2 * double{k6})));
  const double lens_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x);
  const double lens_y = y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y);
  return {fx * lens_x + cx, fy * lens_y + cy};
}

// Newton's method with differences for derivatives.
std::optional<Point> CameraModel::unproject(const Point& pixel) const {
  constexpr int kMostSteps = 30;
  constexpr double kStep = 1e-6;
  constexpr double kCloseEnough = 1e-4;  // pixels
  Point ray = {(pixel.x - cx) / fx, (pixel.y - cy) / fy};
  for (int i = 0; i < kMostSteps; ++i) {
    const Point at = project(ray);
    const double off_x = pixel.x - at.x;
    const double off_y = pixel.y - at.y;
    if (std::hypot(off_x, off_y) < kCloseEnough) return ray;
    const Point right = project({ray.x + kStep, ray.y});
    const Point below = project({ray.x, ray.y + kStep});
    const double xx = (right.x - at.x) / kStep;
    const double yx = (right.y - at.y) / kStep;
    const double xy = (below.x - at.x) / kStep;
    const double yy = (below.y - at.y) / kStep;
    const double determinant = xx * yy - xy * yx;
    ray.x += (yy * off_x - xy * off_y) / determinant;
    ray.y += (xx * off_y - yx * off_x) / determinant;
    if (!std::isfinite(ray.x) || !std::isfinite(ray.y)) break;
  }
  return std::nullopt;
}

CameraModel CameraModel::resized(int new_width, int new_height) const {
  const float sx = static_cast<float>(new_width) / static_cast<float>(width);
  const float sy = static_cast<float>(new_height) / static_cast<float>(height);
  CameraModel out = *this;
  out.width = new_width;
  out.height = new_height;
  out.fx = fx * sx;
  out.fy = fy * sy;
  // Pixel centres sit at integers, so the image's edge is at -0.5.
  out.cx = (cx + 0.5F) * sx - 0.5F;
  out.cy = (cy + 0.5F) * sy - 0.5F;
  return out;
}

CameraModel CameraModel::from_field_of_view(int width, int height, float horizontal_degrees) {
  constexpr float kRadiansPerDegree = 3.14159265F / 180.0F;
  CameraModel model;
  model.width = width;
  model.height = height;
  model.fx = static_cast<float>(width) / 2 / std::tan(horizontal_degrees * kRadiansPerDegree / 2);
  model.fy = model.fx;
  model.cx = (static_cast<float>(width) - 1) / 2;
  model.cy = (static_cast<float>(height) - 1) / 2;
  return model;
}

}  // namespace lcdm
