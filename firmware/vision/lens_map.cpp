#include "firmware/vision/lens_map.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace lcdm {
namespace {

Status folded() {
  return Status::error(StatusCode::kInvalidInput,
                       "the lens distortion folds the picture onto itself: calibrate again, with "
                       "views that reach into its corners");
}

// In rays: what lies within the undistorted picture's border.
struct Rectangle {
  double left = -std::numeric_limits<double>::infinity();
  double top = -std::numeric_limits<double>::infinity();
  double right = std::numeric_limits<double>::infinity();
  double bottom = std::numeric_limits<double>::infinity();
};

// Every side at the innermost point of its undistorted border.
Result<Rectangle> inner_rectangle(const CameraModel& camera) {
  constexpr int kPointsPerSide = 64;
  const double last_x = camera.width - 0.5;
  const double last_y = camera.height - 0.5;
  Rectangle inner;
  for (int i = 0; i <= kPointsPerSide; ++i) {
    const double x = -0.5 + camera.width * (static_cast<double>(i) / kPointsPerSide);
    const double y = -0.5 + camera.height * (static_cast<double>(i) / kPointsPerSide);
    const auto left = camera.unproject({-0.5, y});
    const auto right = camera.unproject({last_x, y});
    const auto top = camera.unproject({x, -0.5});
    const auto bottom = camera.unproject({x, last_y});
    if (!left || !right || !top || !bottom) return folded();
    inner.left = std::max(inner.left, left->x);
    inner.right = std::min(inner.right, right->x);
    inner.top = std::max(inner.top, top->y);
    inner.bottom = std::min(inner.bottom, bottom->y);
  }
  if (inner.left >= inner.right || inner.top >= inner.bottom) return folded();
  return inner;
}

// `length` around `at`, at least a pixel, moved into [0, limit].
Stretch around(double at, double length, int limit) {
  const double wanted = std::clamp(length, 1.0, static_cast<double>(limit));
  return {static_cast<float>(std::clamp(at - wanted / 2, 0.0, limit - wanted)),
          static_cast<float>(wanted)};
}

}  // namespace

Result<CameraModel> pinhole_view(const CameraModel& camera, int width, int height) {
  CameraModel view = camera.resized(width, height);
  if (!camera.distorted()) return view;
  const Result<Rectangle> inner = inner_rectangle(camera);
  if (!inner) return inner.status();
  const double wide = inner->right - inner->left;
  const double high = inner->bottom - inner->top;
  const double zoom = std::max(width / (view.fx * wide), height / (view.fy * high));
  view.distortion = {};
  view.fx = static_cast<float>(view.fx * zoom);
  view.fy = static_cast<float>(view.fy * zoom);
  // The middle of the view looks at the middle of the rectangle.
  view.cx = static_cast<float>((width - 1) / 2.0 - view.fx * (inner->left + wide / 2));
  view.cy = static_cast<float>((height - 1) / 2.0 - view.fy * (inner->top + high / 2));
  return view;
}

Result<std::vector<CameraBox>> make_lens_map(const CameraModel& camera, const CameraModel& view) {
  const auto seen = [&](double u, double v) {
    return camera.project({(u - view.cx) / view.fx, (v - view.cy) / view.fy});
  };
  std::vector<CameraBox> map;
  map.reserve(static_cast<std::size_t>(view.width) * static_cast<std::size_t>(view.height));
  for (int v = 0; v < view.height; ++v) {
    for (int u = 0; u < view.width; ++u) {
      const Point left = seen(u - 0.5, v);
      const Point right = seen(u + 0.5, v);
      const Point above = seen(u, v - 0.5);
      const Point below = seen(u, v + 0.5);
      const double wide = right.x - left.x;
      const double high = below.y - above.y;
      const double twist = (right.y - left.y) * (below.x - above.x);
      const Point at = seen(u, v);
      const bool seen_at_all = std::isfinite(at.x) && std::isfinite(at.y);
      if (!(seen_at_all && wide > 0 && high > 0 && wide * high > twist)) return folded();
      map.push_back(
          {around(at.x + 0.5, wide, camera.width), around(at.y + 0.5, high, camera.height)});
    }
  }
  return map;
}

}  // namespace lcdm
