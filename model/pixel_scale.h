// How networks want their pictures: (value - mean) / deviation of each of R, G and B in [0, 1].
#pragma once

#include <array>
#include <map>
#include <string>

#include "model/torch.h"

namespace lcdm::model {

struct PixelScale {
  std::array<double, 3> mean, deviation;
};

inline constexpr PixelScale kOurPixels{{0.45, 0.45, 0.45}, {0.225, 0.225, 0.225}};  // NETWORK.md
inline constexpr PixelScale kUnitPixels{{0, 0, 0}, {1, 1, 1}};
inline constexpr PixelScale kImagenetPixels{{0.485, 0.456, 0.406}, {0.229, 0.224, 0.225}};

// What other networks were trained with, as commands name it.
inline std::map<std::string, PixelScale> pixel_scale_names() {
  return {{"unit", kUnitPixels}, {"imagenet", kImagenetPixels}};
}

// The three numbers as a tensor [3, 1, 1] on the device of `rgb`.
inline torch::Tensor by_channel(const std::array<double, 3>& values, const torch::Tensor& rgb) {
  return torch::tensor({values[0], values[1], values[2]}, torch::kFloat32)
      .reshape({3, 1, 1})
      .to(rgb.device());
}

// rgb [..., 3, H, W] in [0, 1] -> scaled.
inline torch::Tensor scale_pixels(const torch::Tensor& rgb, const PixelScale& scale) {
  return (rgb - by_channel(scale.mean, rgb)) / by_channel(scale.deviation, rgb);
}

// And back.
inline torch::Tensor unit_pixels(const torch::Tensor& scaled, const PixelScale& scale) {
  return scaled * by_channel(scale.deviation, scaled) + by_channel(scale.mean, scaled);
}

}  // namespace lcdm::model
