// The network of firmware/nn/NETWORK.md in LibTorch: what is trained, and what the engine is held
// to. Shapes are [batch, channels, height, width].
#pragma once

#include <array>
#include <string>
#include <vector>

#include "firmware/nn/network_config.h"
#include "model/torch.h"

namespace lcdm::model {

// Heads of every attention.
inline constexpr int kHeads = 4;

// BatchNorm that can be told to look at what goes through it.
struct NormImpl : torch::nn::NormImplBase<2, NormImpl, torch::nn::BatchNormOptions> {
  explicit NormImpl(int channels);
  torch::Tensor forward(const torch::Tensor& x);
  // x's own statistics normalise it and are not kept.
  torch::Tensor forward_without_trace(const torch::Tensor& x);

  // > 0: x's mean and deviation become a part of the statistics, of this weight; where
  // `keeps_answers`, what is computed in evaluation mode stays the same. See measure_statistics.
  double adopts = 0;
  bool keeps_answers = true;

 private:
  void _check_input_dim(const torch::Tensor& x) override;
};
TORCH_MODULE(Norm);

// Convolution without bias, BatchNorm, and SiLU where `activation`: NETWORK.md's CBA.
struct ConvNormImpl : torch::nn::Module {
  ConvNormImpl(int in, int out, int kernel, int stride, int groups, bool activation);
  torch::Tensor forward(const torch::Tensor& x);

  torch::nn::Conv2d conv = nullptr;
  Norm bn = nullptr;
  bool activation;
};
TORCH_MODULE(ConvNorm);

// MV2: expand, depthwise, project; + input when the shapes agree.
struct InvertedResidualImpl : torch::nn::Module {
  InvertedResidualImpl(int in, int out, int stride, int ratio);
  torch::Tensor forward(const torch::Tensor& x);

  ConvNorm conv1_1x1 = nullptr;
  ConvNorm conv2_kxk = nullptr;
  ConvNorm conv3_1x1 = nullptr;
  bool residual;
};
TORCH_MODULE(InvertedResidual);

// Multi-head attention: x [sequences, tokens, dim] -> the same.
struct AttentionImpl : torch::nn::Module {
  explicit AttentionImpl(int dim);
  torch::Tensor forward(const torch::Tensor& x);

  torch::nn::Linear qkv = nullptr;
  torch::nn::Linear proj = nullptr;
};
TORCH_MODULE(Attention);

struct FeedForwardImpl : torch::nn::Module {
  explicit FeedForwardImpl(int dim);
  torch::Tensor forward(const torch::Tensor& x);

  torch::nn::Linear fc1 = nullptr;
  torch::nn::Linear fc2 = nullptr;
};
TORCH_MODULE(FeedForward);

struct TransformerImpl : torch::nn::Module {
  explicit TransformerImpl(int dim);
  torch::Tensor forward(const torch::Tensor& x);

  torch::nn::LayerNorm norm1 = nullptr;
  Attention attn = nullptr;
  torch::nn::LayerNorm norm2 = nullptr;
  FeedForward mlp = nullptr;
};
TORCH_MODULE(Transformer);

struct MobileVitBlockImpl : torch::nn::Module {
  MobileVitBlockImpl(int channels, int dim, int depth);
  torch::Tensor forward(const torch::Tensor& x);

  ConvNorm conv_kxk = nullptr;
  torch::nn::Conv2d conv_1x1 = nullptr;
  torch::nn::ModuleList transformer = nullptr;
  torch::nn::LayerNorm norm = nullptr;
  ConvNorm conv_proj = nullptr;
  ConvNorm conv_fusion = nullptr;
};
TORCH_MODULE(MobileVitBlock);

struct MobileVitImpl : torch::nn::Module {
  explicit MobileVitImpl(EncoderKind kind);
  // The five taps, finest (1/2) first.
  std::array<torch::Tensor, 5> forward(const torch::Tensor& rgb);

  ConvNorm stem = nullptr;
  torch::nn::ModuleList stages = nullptr;  // of ModuleLists of blocks
  ConvNorm final_conv = nullptr;
  std::array<int, 5> channels{};  // of the taps
};
TORCH_MODULE(MobileVit);

struct DecoderImpl : torch::nn::Module {
  DecoderImpl(const ModelConfig& config, const std::array<int, 5>& taps);
  // The condition [batch, 16, H, W].
  torch::Tensor forward(const std::array<torch::Tensor, 5>& taps);

  std::array<std::array<torch::nn::Conv2d, 2>, 5> upconv{{{nullptr, nullptr},
                                                          {nullptr, nullptr},
                                                          {nullptr, nullptr},
                                                          {nullptr, nullptr},
                                                          {nullptr, nullptr}}};
  torch::nn::Conv2d condition = nullptr;
  bool bilinear;
};
TORCH_MODULE(Decoder);

// Whether a pass through the head's norm moves its running statistics: those of a sampler step must
// come from what the sampler shows it, not from the denoising loss's random times.
enum class Statistics : std::uint8_t { kUpdate, kLeave };

struct HeadImpl : torch::nn::Module {
  explicit HeadImpl(const ModelConfig& config);

  // One evaluation. condition [B, 16, H, W], x [B, 1, H, W], times [B] int64; `step` selects the
  // norm. Returns [B, 1, H, W].
  torch::Tensor forward(const torch::Tensor& condition, const torch::Tensor& x,
                        const torch::Tensor& times, int step, Statistics statistics);
  // The output of conv1, norm and ReLU: as above, without conv2.
  torch::Tensor hidden(const torch::Tensor& condition, const torch::Tensor& x,
                       const torch::Tensor& times, int step, Statistics statistics);

  torch::nn::Conv2d embed = nullptr;
  torch::Tensor time_embed;  // [150, 16]
  torch::nn::Conv2d conv1 = nullptr;
  std::vector<Norm> norm;                     // one per sampler step; empty for `paper`
  torch::nn::GroupNorm group_norm = nullptr;  // `paper`
  torch::nn::Conv2d conv2 = nullptr;
};
TORCH_MODULE(Head);

// The whole network. Not thread-safe.
struct DepthNetworkImpl : torch::nn::Module {
  explicit DepthNetworkImpl(const ModelConfig& config);

  // Normalised RGB [B, 3, H, W] -> condition [B, 16, H, W], float; computed in bfloat16 where
  // `mixed_precision` is set.
  torch::Tensor condition_of(const torch::Tensor& rgb);
  // The sampler with `steps` evaluations from the fixed start; the diffusion variable
  // [B, 1, H, W]. steps = 0: the direct convolution. With config().steps.size() steps it is exactly
  // what ships.
  torch::Tensor sample(const torch::Tensor& condition, int steps);
  // The sampler's start for this size, [1, 1, H, W].
  torch::Tensor start(int height, int width);
  // Index of the configured sampler step nearest to time t: it has the norm for t.
  int step_of(int t) const;

  ModelConfig config;
  bool mixed_precision = false;  // training only
  MobileVit encoder = nullptr;
  Decoder decoder = nullptr;
  Head head = nullptr;
  torch::nn::Conv2d direct = nullptr;  // 3x3, condition -> variable; not exported
};
TORCH_MODULE(DepthNetwork);

// What becomes of a batch norm's answers where its statistics are measured: they stay, for weights
// that were trained with others (folded away ones); or the norm normalises again, for weights that
// were never trained, or on other pictures.
enum class Answers : std::uint8_t { kKeep, kNormalise };

// Gives every batch norm of `part` (of the network, or the whole) the statistics of what it sees of
// `pictures` (batches of normalised RGB).
void measure_statistics(DepthNetwork& network, torch::nn::Module& part, Answers answers,
                        const std::vector<torch::Tensor>& pictures);

// x [B, C, H, W] with even H, W -> [B * 4, H/2 * W/2, C], one sequence per position in a 2x2 patch.
torch::Tensor unfold_patches(const torch::Tensor& x);
torch::Tensor fold_patches(const torch::Tensor& tokens, std::int64_t batch, std::int64_t height,
                           std::int64_t width);

}  // namespace lcdm::model
