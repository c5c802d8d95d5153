#include "firmware/vision/camera_model.h"

#include <Eigen/LU>
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
  using Eigen::Vector2d;
  constexpr int kMostSteps = 30;
  constexpr double kStep = 1e-6;
  constexpr double kCloseEnough = 1e-4;  // pixels
  const auto seen = [this](const Vector2d& ray) {
    const Point at = project({ray.x(), ray.y()});
    return Vector2d(at.x, at.y);
  };
  Vector2d ray((pixel.x - cx) / fx, (pixel.y - cy) / fy);
  for (int i = 0; i < kMostSteps && ray.allFinite(); ++i) {
    const Vector2d at = seen(ray);
    const Vector2d off = Vector2d(pixel.x, pixel.y) - at;
    if (off.norm() < kCloseEnough) return Point{ray.x(), ray.y()};
    Eigen::Matrix2d slope;
    slope << seen(ray + kStep * Vector2d::UnitX()) - at, seen(ray + kStep * Vector2d::UnitY()) - at;
    ray += kStep * slope.inverse() * off;
  }
  return std::nullopt;
}

bool CameraModel::has_shape(int other_width, int other_height) const {
  constexpr double kSame = 0.005;
  const double x = static_cast<double>(other_width) / width;
  const double y = static_cast<double>(other_height) / height;
  return std::abs(x - y) <= kSame * x;
}

CameraModel CameraModel::resized(int new_width, int new_height) const {
  if (new_width == width && new_height == height) return *this;  // nothing is rounded
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
