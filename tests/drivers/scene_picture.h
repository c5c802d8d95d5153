// A picture of the rendered scene, with what it shows.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "drivers/scene/scene.h"
#include "firmware/vision/camera_model.h"

namespace lcdm::scene {

struct Picture {
  CameraModel camera;
  std::vector<std::uint8_t> rgb;
  std::vector<float> depth;
  Snapshot snapshot;

  float depth_at(int x, int y) const {
    return depth[static_cast<std::size_t>(y) * static_cast<std::size_t>(camera.width) +
                 static_cast<std::size_t>(x)];
  }
  const std::uint8_t* colour_at(int x, int y) const {
    return &rgb[3 * (static_cast<std::size_t>(y) * static_cast<std::size_t>(camera.width) +
                     static_cast<std::size_t>(x))];
  }
};

inline std::unique_ptr<Picture> blank(int width, int height, float field_of_view) {
  auto picture = std::make_unique<Picture>();
  picture->camera = CameraModel::from_field_of_view(width, height, field_of_view);
  const auto pixels = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  picture->rgb.resize(3 * pixels);
  picture->depth.resize(pixels);
  return picture;
}

}  // namespace lcdm::scene
