// Frames with teacher depth, kept in memory, and the batches made of them.
#pragma once

#include <cstdint>
#include <memory>
#include <opencv2/core.hpp>
#include <random>
#include <string>
#include <torch/types.h>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/vision/camera_model.h"

namespace lcdm::model {

// One picture as the packs give it, made smaller where it was large.
struct Frame {
  std::string name;
  cv::Mat rgb;         // 8UC3, RGB
  cv::Mat depth;       // 32FC1, metres, 0 = unknown; may have another size than rgb
  CameraModel camera;  // of rgb
};

// A folder of frames of one origin (shared packs: rgb/, depth/ or teacher_meter/, intrinsics.json).
struct Pack {
  std::string name;
  std::vector<Frame> frames;    // in recording order
  bool sensor_depth = false;    // a sensor's, not another network's
  bool reliable_scale = false;  // intrinsics and depth unit are known
};

struct PackOptions {
  int max_width = 640;               // larger pictures are shrunk to it when read
  float assumed_field_of_view = 60;  // where the intrinsics are unknown
};

// Reads rgb/*.jpg|png and the depth beside them. A picture without depth is left out; a broken one
// is an error that names it.
Result<Pack> load_pack(const std::string& folder, const PackOptions& options);

// Validation: the last tenth of a sequence, after a gap of 20 frames (fewer in short sequences).
struct Split {
  std::vector<const Frame*> train;
  std::vector<const Frame*> validation;
};
Split split_pack(const Pack& pack);

struct AugmentOptions {
  bool enabled = true;
  float min_crop = 0.65F;  // of the largest crop of the wanted shape
};

// What a network sees: image [3, H, W] normalised as NETWORK.md says, depth [1, H, W] metres at the
// canonical focal length (0 = invalid).
struct Sample {
  torch::Tensor image;
  torch::Tensor depth;
};

// Crops, resizes, flips and recolours one frame. Deterministic in `random`.
Sample make_sample(const Frame& frame, int width, int height, double canonical_focal,
                   const AugmentOptions& augment, std::mt19937_64& random);

}  // namespace lcdm::model
