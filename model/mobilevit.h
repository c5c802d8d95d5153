// The MobileViT encoder (Mehta and Rastegari 2022), with timm's module names. NETWORK.md,
// "Encoder".
#pragma once

#include <array>
#include <torch/nn/modules/batchnorm.h>
#include <torch/nn/modules/container/modulelist.h>
#include <torch/nn/modules/conv.h>
#include <torch/nn/modules/linear.h>
#include <torch/nn/modules/normalization.h>
#include <vector>

#include "firmware/nn/network_config.h"

namespace lcdm::model {

struct EncoderShape {
  int ratio;                    // expansion of the MV2 blocks
  int stage0;                   // channels at 1/2
  int stage1;                   // channels at 1/4
  std::array<int, 3> channels;  // stages 2, 3, 4
  std::array<int, 3> width;     // of their transformers
  std::array<int, 3> depth;     // blocks in them
  int out;                      // channels of final_conv

  static EncoderShape of(EncoderKind kind);
  // Channels of the taps, finest first.
  std::array<int, 5> taps() const;
};

// Convolution without bias, BatchNorm and, unless `activate` is false, SiLU.
struct ConvNormActImpl : torch::nn::Module {
  ConvNormActImpl(int in, int out, int kernel, int stride = 1, int groups = 1,
                  bool activate = true);
  torch::Tensor forward(const torch::Tensor& x);

  torch::nn::Conv2d conv{nullptr};
  torch::nn::BatchNorm2d bn{nullptr};
  const bool activate;
};
TORCH_MODULE(ConvNormAct);

// Inverted residual: expand 1x1, depthwise 3x3, project 1x1.
struct Mv2Impl : torch::nn::Module {
  Mv2Impl(int in, int out, int stride, int ratio);
  torch::Tensor forward(const torch::Tensor& x);

  ConvNormAct conv1_1x1{nullptr}, conv2_kxk{nullptr}, conv3_1x1{nullptr};
  const bool residual;
};
TORCH_MODULE(Mv2);

// Pre-norm transformer block over [sequences, tokens, width].
struct TransformerBlockImpl : torch::nn::Module {
  explicit TransformerBlockImpl(int width);
  torch::Tensor forward(const torch::Tensor& x);

  static constexpr int kHeads = 4;
  torch::nn::LayerNorm norm1{nullptr}, norm2{nullptr};
  torch::nn::Linear qkv{nullptr}, proj{nullptr}, fc1{nullptr}, fc2{nullptr};
};
TORCH_MODULE(TransformerBlock);

// Local convolution, then attention among the pixels at one place of every 2x2 patch.
struct MobileVitBlockImpl : torch::nn::Module {
  MobileVitBlockImpl(int channels, int width, int depth);
  torch::Tensor forward(const torch::Tensor& x);

  ConvNormAct conv_kxk{nullptr}, conv_proj{nullptr}, conv_fusion{nullptr};
  torch::nn::Conv2d conv_1x1{nullptr};
  torch::nn::ModuleList transformer{nullptr};
  torch::nn::LayerNorm norm{nullptr};
};
TORCH_MODULE(MobileVitBlock);

// [batch, 3, H, W] -> features at 1/2, 1/4, 1/8, 1/16, 1/32, finest first.
struct EncoderImpl : torch::nn::Module {
  explicit EncoderImpl(EncoderKind kind);
  std::array<torch::Tensor, 5> forward(const torch::Tensor& image);

  ConvNormAct stem{nullptr}, final_conv{nullptr};
  std::vector<Mv2> head_blocks;  // stages 0 and 1
  std::array<Mv2, 3> reduce{Mv2{nullptr}, Mv2{nullptr}, Mv2{nullptr}};
  std::array<MobileVitBlock, 3> attend{MobileVitBlock{nullptr}, MobileVitBlock{nullptr},
                                       MobileVitBlock{nullptr}};
};
TORCH_MODULE(Encoder);

}  // namespace lcdm::model
