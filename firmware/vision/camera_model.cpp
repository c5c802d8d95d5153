#include "firmware/vision/camera_model.h"

#include <cmath>

namespace lcdm {

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
