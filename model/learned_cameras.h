// Focal lengths that nobody measured, learned from the photometric loss beside depth and motion
// (arXiv 1904.04998): a drive turns and shakes, and only the right ones make its views agree.
#pragma once

#include "model/geometry.h"

namespace lcdm::model {

// Of one camera a pack; what it assumed is the start. The principal point stays.
struct LearnedCamerasImpl : torch::nn::Module {
  explicit LearnedCamerasImpl(std::int64_t cameras);

  // `assumed` with its focal lengths multiplied; which [B] int64 names each image's camera, -1
  // where the intrinsics are known.
  Pinholes forward(const Pinholes& assumed, const torch::Tensor& which);

  std::int64_t cameras() const { return log_focal.size(0) / 2; }

  // Of fx and fy over the assumed ones, camera by camera: [2 cameras], because vectors are not
  // decayed (optimizer.h).
  torch::Tensor log_focal;
};
TORCH_MODULE(LearnedCameras);

}  // namespace lcdm::model
