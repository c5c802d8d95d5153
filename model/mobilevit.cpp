#include "model/mobilevit.h"

#include <string>
#include <torch/nn/functional/activation.h>
#include <torch/nn/functional/upsampling.h>

namespace lcdm::model {
namespace {

namespace F = torch::nn::functional;
using torch::Tensor;

// ml-cvnets' make_divisible: to the nearest multiple of 8, never below nine tenths.
int make_divisible(int value) {
  int rounded = std::max(8, (value + 4) / 8 * 8);
  if (10 * rounded < 9 * value) rounded += 8;
  return rounded;
}

Tensor resize(const Tensor& x, int64_t height, int64_t width) {
  return F::interpolate(x, F::InterpolateFuncOptions()
                               .size(std::vector<int64_t>{height, width})
                               .mode(torch::kBilinear)
                               .align_corners(false));
}

torch::nn::LayerNorm layer_norm(int width) {
  return torch::nn::LayerNorm(torch::nn::LayerNormOptions({width}).eps(1e-5));
}

}  // namespace

EncoderShape EncoderShape::of(EncoderKind kind) {
  switch (kind) {
    case EncoderKind::kXxs:
      return {2, 16, 24, {48, 64, 80}, {64, 80, 96}, {2, 4, 3}, 320};
    case EncoderKind::kXs:
      return {4, 32, 48, {64, 80, 96}, {96, 120, 144}, {2, 4, 3}, 384};
    case EncoderKind::kS:
      return {4, 32, 64, {96, 128, 160}, {144, 192, 240}, {2, 4, 3}, 640};
  }
  return {};
}

std::array<int, 5> EncoderShape::taps() const {
  return {stage0, stage1, channels[0], channels[1], out};
}

ConvNormActImpl::ConvNormActImpl(int in, int out, int kernel, int stride, int groups,
                                 bool activate_)
    : activate(activate_) {
  conv = register_module("conv", torch::nn::Conv2d(torch::nn::Conv2dOptions(in, out, kernel)
                                                       .stride(stride)
                                                       .padding(kernel / 2)
                                                       .groups(groups)
                                                       .bias(false)));
  bn = register_module("bn", torch::nn::BatchNorm2d(torch::nn::BatchNorm2dOptions(out).eps(1e-5)));
}

Tensor ConvNormActImpl::forward(const Tensor& x) {
  const Tensor y = bn(conv(x));
  return activate ? torch::silu(y) : y;
}

Mv2Impl::Mv2Impl(int in, int out, int stride, int ratio) : residual(stride == 1 && in == out) {
  const int hidden = make_divisible(in * ratio);
  conv1_1x1 = register_module("conv1_1x1", ConvNormAct(in, hidden, 1));
  conv2_kxk = register_module("conv2_kxk", ConvNormAct(hidden, hidden, 3, stride, hidden));
  conv3_1x1 = register_module("conv3_1x1", ConvNormAct(hidden, out, 1, 1, 1, false));
}

Tensor Mv2Impl::forward(const Tensor& x) {
  const Tensor y = conv3_1x1(conv2_kxk(conv1_1x1(x)));
  return residual ? x + y : y;
}

TransformerBlockImpl::TransformerBlockImpl(int width) {
  // timm nests these as attn.* and mlp.*; a name with a dot is not allowed in LibTorch.
  auto attn = std::make_shared<torch::nn::Module>();
  auto mlp = std::make_shared<torch::nn::Module>();
  norm1 = register_module("norm1", layer_norm(width));
  qkv = attn->register_module("qkv", torch::nn::Linear(width, 3 * width));
  proj = attn->register_module("proj", torch::nn::Linear(width, width));
  register_module("attn", attn);
  norm2 = register_module("norm2", layer_norm(width));
  fc1 = mlp->register_module("fc1", torch::nn::Linear(width, 2 * width));
  fc2 = mlp->register_module("fc2", torch::nn::Linear(2 * width, width));
  register_module("mlp", mlp);
}

Tensor TransformerBlockImpl::forward(const Tensor& x) {
  const int64_t sequences = x.size(0), tokens = x.size(1), width = x.size(2);
  const int64_t per_head = width / kHeads;
  const auto parts = qkv(norm1(x))
                         .view({sequences, tokens, 3, kHeads, per_head})
                         .permute({2, 0, 3, 1, 4})
                         .unbind(0);  // q, k, v: [sequences, heads, tokens, per_head]
  const Tensor weights =
      torch::softmax(torch::matmul(parts[0] * (1.0 / std::sqrt(static_cast<double>(per_head))),
                                   parts[1].transpose(-2, -1)),
                     -1);
  const Tensor mixed =
      torch::matmul(weights, parts[2]).transpose(1, 2).reshape({sequences, tokens, width});
  const Tensor y = x + proj(mixed);
  return y + fc2(torch::silu(fc1(norm2(y))));
}

MobileVitBlockImpl::MobileVitBlockImpl(int channels, int width, int depth) {
  conv_kxk = register_module("conv_kxk", ConvNormAct(channels, channels, 3));
  conv_1x1 = register_module(
      "conv_1x1", torch::nn::Conv2d(torch::nn::Conv2dOptions(channels, width, 1).bias(false)));
  transformer = register_module("transformer", torch::nn::ModuleList());
  for (int i = 0; i < depth; ++i) transformer->push_back(TransformerBlock(width));
  norm = register_module("norm", layer_norm(width));
  conv_proj = register_module("conv_proj", ConvNormAct(width, channels, 1));
  conv_fusion = register_module("conv_fusion", ConvNormAct(2 * channels, channels, 3));
}

Tensor MobileVitBlockImpl::forward(const Tensor& x) {
  Tensor y = conv_1x1(conv_kxk(x));
  const int64_t batch = y.size(0), width = y.size(1), h = y.size(2), w = y.size(3);
  const int64_t rows = (h + 1) / 2, columns = (w + 1) / 2;
  const bool odd = h % 2 != 0 || w % 2 != 0;
  if (odd) y = resize(y, 2 * rows, 2 * columns);
  // [batch, width, rows, 2, columns, 2] -> [batch, 2, 2, rows, columns, width] -> sequences.
  y = y.contiguous()
          .view({batch, width, rows, 2, columns, 2})
          .permute({0, 3, 5, 2, 4, 1})
          .reshape({batch * 4, rows * columns, width});
  for (const auto& block : *transformer) y = block->as<TransformerBlock>()->forward(y);
  y = norm(y)
          .view({batch, 2, 2, rows, columns, width})
          .permute({0, 5, 3, 1, 4, 2})
          .reshape({batch, width, 2 * rows, 2 * columns});
  if (odd) y = resize(y, h, w);
  return conv_fusion(torch::cat({x, conv_proj(y)}, 1));
}

EncoderImpl::EncoderImpl(EncoderKind kind) {
  const EncoderShape s = EncoderShape::of(kind);
  stem = register_module("stem", ConvNormAct(3, 16, 3, 2));
  const auto stages = register_module("stages", torch::nn::ModuleList());
  torch::nn::ModuleList stage0, stage1;
  head_blocks = {Mv2(16, s.stage0, 1, s.ratio), Mv2(s.stage0, s.stage1, 2, s.ratio),
                 Mv2(s.stage1, s.stage1, 1, s.ratio), Mv2(s.stage1, s.stage1, 1, s.ratio)};
  stage0->push_back(head_blocks[0]);
  for (std::size_t i = 1; i < head_blocks.size(); ++i) stage1->push_back(head_blocks[i]);
  stages->push_back(stage0);
  stages->push_back(stage1);
  int in = s.stage1;
  for (std::size_t i = 0; i < 3; ++i) {
    reduce[i] = Mv2(in, s.channels[i], 2, s.ratio);
    attend[i] = MobileVitBlock(s.channels[i], s.width[i], s.depth[i]);
    in = s.channels[i];
    torch::nn::ModuleList stage;
    stage->push_back(reduce[i]);
    stage->push_back(attend[i]);
    stages->push_back(stage);
  }
  final_conv = register_module("final_conv", ConvNormAct(in, s.out, 1));
}

std::array<Tensor, 5> EncoderImpl::forward(const Tensor& image) {
  std::array<Tensor, 5> taps;
  taps[0] = head_blocks[0](stem(image));
  taps[1] = head_blocks[3](head_blocks[2](head_blocks[1](taps[0])));
  taps[2] = attend[0](reduce[0](taps[1]));
  taps[3] = attend[1](reduce[1](taps[2]));
  taps[4] = final_conv(attend[2](reduce[2](taps[3])));
  return taps;
}

}  // namespace lcdm::model
