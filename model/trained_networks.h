// What training changes: the depth network and, for self-supervision, the pose network and
// the cameras.
#pragma once

#include "model/learned_cameras.h"
#include "model/network.h"
#include "model/pose_net.h"

namespace lcdm::model {

struct TrainedNetworksImpl : torch::nn::Module {
  // `learned_cameras`: how many packs have intrinsics to be learned.
  TrainedNetworksImpl(const ModelConfig& config, bool with_pose, std::int64_t learned_cameras = 0) {
    depth = register_module("depth", DepthNetwork(config));
    if (with_pose) pose = register_module("pose", PoseNet());
    if (learned_cameras > 0) cameras = register_module("cameras", LearnedCameras(learned_cameras));
  }

  DepthNetwork depth = nullptr;
  PoseNet pose = nullptr;            // empty without self-supervision
  LearnedCameras cameras = nullptr;  // empty where all intrinsics are known
};
TORCH_MODULE(TrainedNetworks);

}  // namespace lcdm::model
