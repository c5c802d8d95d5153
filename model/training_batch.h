// What one training step is made of.
#pragma once

#include <functional>

#include "firmware/base/status.h"
#include "model/geometry.h"
#include "model/torch.h"

namespace lcdm::model {

// The supervision of one batch, at the canonical focal length.
struct Target {
  torch::Tensor depth;      // [B, 1, H, W]; 0 where unknown
  torch::Tensor weight;     // [B]; how far the sample's depth is trusted
  torch::Tensor sharp;      // [B]; 1 where its edges are, 0 where the teacher blurs them
  torch::Tensor alignment;  // [B] int64, of enum Alignment: what of it is not to be believed
};

// The same pictures and their neighbours in time as the camera gave them, without colour jitter:
// [B, 3, H, W] in [0, 1]. Undefined tensors where nothing learns from them.
struct Views {
  torch::Tensor here, earlier, later;
  torch::Tensor present;  // [B]; 1 where both neighbours exist, else 0
};

struct Batch {
  torch::Tensor rgb;             // [B, 3, H, W], normalised, channels-last
  Pinholes cameras;              // of these pictures
  torch::Tensor learned_camera;  // [B] int64; which LearnedCameras corrects, -1: they are known
  Target target;
  Views views;
  int unreadable = 0;     // frames that were drawn and could not be read
  Status why_unreadable;  // the last of them

  // The samples [first, first + count).
  Batch part(std::int64_t first, std::int64_t count) const;
  Batch to(const torch::Device& device) const;

 private:
  // With every tensor that is there changed.
  Batch map(const std::function<torch::Tensor(const torch::Tensor&)>& change) const;
};

}  // namespace lcdm::model
