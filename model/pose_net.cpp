#include "model/pose_net.h"

namespace lcdm::model {
namespace {

namespace nn = torch::nn;

constexpr int kWidths[4] = {64, 128, 256, 512};
// The network's numbers are small at first, so that training starts near no motion.
constexpr double kPoseUnit = 0.01;
constexpr int kNumbers = 12;  // of two pairs; only the first is used, as in Monodepth2

nn::Conv2d conv(int in, int out, int kernel, int stride, bool bias) {
  return nn::Conv2d(
      nn::Conv2dOptions(in, out, kernel).stride(stride).padding(kernel / 2).bias(bias));
}

nn::Sequential make_layer(int in, int out, int stride) {
  nn::Sequential layer;
  layer->push_back(BasicBlock(in, out, stride));
  layer->push_back(BasicBlock(out, out, 1));
  return layer;
}

}  // namespace

BasicBlockImpl::BasicBlockImpl(int in, int out, int stride) {
  conv1 = register_module("conv1", conv(in, out, 3, stride, false));
  bn1 = register_module("bn1", nn::BatchNorm2d(out));
  conv2 = register_module("conv2", conv(out, out, 3, 1, false));
  bn2 = register_module("bn2", nn::BatchNorm2d(out));
  if (stride != 1 || in != out) {
    downsample = register_module(
        "downsample", nn::Sequential(conv(in, out, 1, stride, false), nn::BatchNorm2d(out)));
  }
}

torch::Tensor BasicBlockImpl::forward(const torch::Tensor& x) {
  const torch::Tensor y =
      bn2->forward(conv2->forward(torch::relu(bn1->forward(conv1->forward(x)))));
  return torch::relu(y + (downsample.is_empty() ? x : downsample->forward(x)));
}

ResNet18Impl::ResNet18Impl(int channels) {
  conv1 = register_module(
      "conv1", nn::Conv2d(nn::Conv2dOptions(channels, 64, 7).stride(2).padding(3).bias(false)));
  bn1 = register_module("bn1", nn::BatchNorm2d(64));
  layer1 = register_module("layer1", make_layer(64, kWidths[0], 1));
  layer2 = register_module("layer2", make_layer(kWidths[0], kWidths[1], 2));
  layer3 = register_module("layer3", make_layer(kWidths[1], kWidths[2], 2));
  layer4 = register_module("layer4", make_layer(kWidths[2], kWidths[3], 2));
}

torch::Tensor ResNet18Impl::forward(const torch::Tensor& x) {
  torch::Tensor y = torch::relu(bn1->forward(conv1->forward(x)));
  y = torch::max_pool2d(y, 3, 2, 1);
  return layer4->forward(layer3->forward(layer2->forward(layer1->forward(y))));
}

PoseNetImpl::PoseNetImpl() {
  constexpr int kWidth = 256;
  encoder = register_module("encoder", ResNet18(6));
  squeeze = register_module("squeeze", conv(kWidths[3], kWidth, 1, 1, true));
  pose_0 = register_module("pose_0", conv(kWidth, kWidth, 3, 1, true));
  pose_1 = register_module("pose_1", conv(kWidth, kWidth, 3, 1, true));
  pose_2 = register_module("pose_2", conv(kWidth, kNumbers, 1, 1, true));
}

Motion PoseNetImpl::forward(const torch::Tensor& earlier, const torch::Tensor& later) {
  torch::Tensor y = encoder->forward(torch::cat({earlier, later}, 1));
  y = torch::relu(squeeze->forward(y));
  y = torch::relu(pose_0->forward(y));
  y = torch::relu(pose_1->forward(y));
  y = kPoseUnit * pose_2->forward(y).mean({2, 3});
  return {y.narrow(1, 0, 3), y.narrow(1, 3, 3)};
}

}  // namespace lcdm::model
