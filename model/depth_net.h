// LCDM-Mono's DepthNet: encoder, decoder to the condition, denoising head, sampler. NETWORK.md.
#pragma once

#include <array>
#include <torch/nn/modules/embedding.h>
#include <vector>

#include "firmware/nn/sampler.h"
#include "model/mobilevit.h"

namespace lcdm::model {

// The decoder's features at full size. Taps and the condition: [batch, channels, height, width].
struct DecoderImpl : torch::nn::Module {
  DecoderImpl(const ModelConfig& config);
  torch::Tensor forward(const std::array<torch::Tensor, 5>& taps);

  torch::Tensor upsample2(const torch::Tensor& x) const;

  const bool paper;
  struct Level {
    torch::nn::Conv2d before{nullptr}, after{nullptr};  // the upsampling: upconv_{i}_0 and _1
  };
  std::array<Level, 5> levels;  // [0] at full size
  torch::nn::Conv2d condition{nullptr};
};
TORCH_MODULE(Decoder);

// One denoising evaluation. The norm's statistics are each sampler step's own in preset `lcdm`.
struct HeadImpl : torch::nn::Module {
  explicit HeadImpl(const ModelConfig& config);

  // condition [B, 16, H, W], x [B, 1, H, W], t [B] (int64) -> prediction [B, 1, H, W]. The images
  // of a batch may stand at different t; each uses the norm of the nearest sampler step.
  torch::Tensor forward(const torch::Tensor& condition, const torch::Tensor& x,
                        const torch::Tensor& t);
  int norm_index(int t) const;

  const bool paper;
  const std::vector<int> steps;
  torch::nn::Conv2d embed{nullptr}, conv1{nullptr}, conv2{nullptr};
  torch::nn::Embedding time_embed{nullptr};
  torch::nn::GroupNorm group_norm{nullptr};        // preset paper
  std::vector<torch::nn::BatchNorm2d> step_norms;  // preset lcdm, one a sampler step

 private:
  torch::Tensor normalise(const torch::Tensor& h, const torch::Tensor& t);
};
TORCH_MODULE(Head);

struct DepthNetImpl : torch::nn::Module {
  explicit DepthNetImpl(const ModelConfig& config);

  // image [B, 3, H, W], normalised -> condition [B, 16, H, W].
  torch::Tensor condition(const torch::Tensor& image);
  // DDIM from `start` [B, 1, H, W] with sigma = 0 over `sampler` -> the diffusion variable.
  torch::Tensor sample(const torch::Tensor& condition, const torch::Tensor& start,
                       const std::vector<int>& sampler);
  // The answer without diffusion: trained beside, dropped at export.
  torch::Tensor direct_answer(const torch::Tensor& condition) { return direct(condition); }
  // x0 from a noisy x at t [B] and the head's prediction.
  torch::Tensor clean_estimate(const torch::Tensor& x, const torch::Tensor& prediction,
                               const torch::Tensor& t) const;
  // What the head is trained to predict: v or eps.
  torch::Tensor target(const torch::Tensor& x0, const torch::Tensor& noise,
                       const torch::Tensor& t) const;
  // x_t of Eq. 4.
  torch::Tensor add_noise(const torch::Tensor& x0, const torch::Tensor& noise,
                          const torch::Tensor& t) const;
  // Diffusion variable -> depth at the canonical focal length, metres in [0.1, 100].
  torch::Tensor to_depth(const torch::Tensor& variable) const;
  torch::Tensor to_variable(const torch::Tensor& depth) const;

  ModelConfig config;
  const std::vector<double> abar;
  Encoder encoder{nullptr};
  Decoder decoder{nullptr};
  Head head{nullptr};
  torch::nn::Conv2d direct{nullptr};

 private:
  torch::Tensor abar_at(const torch::Tensor& t) const;  // [B] -> [B, 1, 1, 1]
};
TORCH_MODULE(DepthNet);

}  // namespace lcdm::model
