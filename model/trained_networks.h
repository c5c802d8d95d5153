// What training changes: the depth network and, for self-supervision, the pose network.
#pragma once

#include "model/network.h"
#include "model/pose_net.h"

namespace lcdm::model {

struct TrainedNetworksImpl : torch::nn::Module {
  TrainedNetworksImpl(const ModelConfig& config, bool with_pose) {
    depth = register_module("depth", DepthNetwork(config));
    if (with_pose) pose = register_module("pose", PoseNet());
  }

  DepthNetwork depth = nullptr;
  PoseNet pose = nullptr;  // empty without self-supervision
};
TORCH_MODULE(TrainedNetworks);

}  // namespace lcdm::model
