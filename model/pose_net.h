// How the camera moved between two frames (Monodepth2, arXiv 1806.01260): ResNet18 on the pair,
// four convolutions, six numbers. Trained beside the depth network, never shipped.
#pragma once

#include "model/torch.h"

namespace lcdm::model {

// ResNet18's block of two 3x3 convolutions (arXiv 1512.03385); torchvision's names.
struct BasicBlockImpl : torch::nn::Module {
  BasicBlockImpl(int in, int out, int stride);
  torch::Tensor forward(const torch::Tensor& x);

  torch::nn::Conv2d conv1 = nullptr, conv2 = nullptr;
  torch::nn::BatchNorm2d bn1 = nullptr, bn2 = nullptr;
  torch::nn::Sequential downsample = nullptr;  // empty where the shapes agree
};
TORCH_MODULE(BasicBlock);

// ResNet18 without its classifier: [B, channels, H, W] -> [B, 512, H/32, W/32].
struct ResNet18Impl : torch::nn::Module {
  explicit ResNet18Impl(int channels);
  torch::Tensor forward(const torch::Tensor& x);

  torch::nn::Conv2d conv1 = nullptr;
  torch::nn::BatchNorm2d bn1 = nullptr;
  torch::nn::Sequential layer1 = nullptr, layer2 = nullptr, layer3 = nullptr, layer4 = nullptr;
};
TORCH_MODULE(ResNet18);

struct Motion {
  torch::Tensor axis_angle;   // [B, 3], radians
  torch::Tensor translation;  // [B, 3], of the depth's unit
};

struct PoseNetImpl : torch::nn::Module {
  PoseNetImpl();
  // Two normalised pictures [B, 3, H, W] in the order they were taken; the motion takes points
  // seen from the first to the second camera's frame.
  Motion forward(const torch::Tensor& earlier, const torch::Tensor& later);

  ResNet18 encoder = nullptr;
  torch::nn::Conv2d squeeze = nullptr, pose_0 = nullptr, pose_1 = nullptr, pose_2 = nullptr;
};
TORCH_MODULE(PoseNet);

}  // namespace lcdm::model
