// What training minimises. Tensors are [B, 1, H, W]; masks are bool of the same shape; every loss
// is a scalar with gradients to its first argument.
#pragma once

#include "firmware/nn/network_config.h"
#include "model/network.h"
#include "model/torch.h"

namespace lcdm::model {

// The supervision of one batch, at the canonical focal length.
struct Target {
  torch::Tensor depth;     // [B, 1, H, W]; 0 where unknown
  torch::Tensor weight;    // [B]; how far the sample's depth is trusted
  torch::Tensor sharp;     // [B]; 1 where its edges are, 0 where the teacher blurs them
  torch::Tensor reliable;  // [B] bool; false: its scale says nothing
};

struct LossWeights {
  double distillation = 1;
  double denoising = 1;
  double gradient = 0.5;  // multi-scale matching of log-depth gradients
  double direct = 0.5;    // the 0-step output's share of the distillation and gradient losses
};

struct Losses {
  torch::Tensor total = torch::zeros({});  // with gradients
  double distillation = 0;
  double denoising = 0;
  double gradient = 0;
  double direct = 0;

  Losses times(double factor) const;
  void add(const Losses& other);  // takes no gradients over
};

// Mean over the images (weighted) of each image's mean of |error| over its mask. Images without a
// valid pixel count as nothing.
torch::Tensor masked_mean(const torch::Tensor& error, const torch::Tensor& mask,
                          const torch::Tensor& weight);

// Depth distillation: L1 on log depth, split into shape and scale. Of every image, e = log_depth -
// log_target: mean |e - mean e| + kScaleWeight |mean e|. One picture hardly tells its scale, so an
// undivided L1 is mostly scale, and its noise hides the shape.
inline constexpr double kScaleWeight = 0.3;
torch::Tensor log_depth_loss(const torch::Tensor& log_depth, const torch::Tensor& log_target,
                             const torch::Tensor& mask, const torch::Tensor& weight);

// Multi-scale gradient matching (MegaDepth, arXiv 1804.00607, equation 6): L1 of the x and y
// differences of log_depth - log_target over every 1st, 2nd, 4th and 8th pixel, where both ends are
// valid; mean of the scales.
torch::Tensor gradient_loss(const torch::Tensor& log_depth, const torch::Tensor& log_target,
                            const torch::Tensor& mask, const torch::Tensor& weight);

// log_target of unreliable images moved so that its median error to the student is 0. The student
// gets no gradient from it.
torch::Tensor align_to_student(const torch::Tensor& log_target, const torch::Tensor& log_depth,
                               const torch::Tensor& mask, const torch::Tensor& reliable);

// The times and noise of one denoising pass. All times of a batch belong to one sampler step.
struct DenoisingDraw {
  torch::Tensor times;  // [B] int64
  torch::Tensor noise;  // [B, 1, H, W], N(0, 1)
  int step = 0;
};
DenoisingDraw draw_denoising(const DepthNetwork& network, at::Generator& generator,
                             c10::IntArrayRef shape);

// Squared error of the prediction (v for `lcdm`, eps for `paper`) at x_t made from the target
// variable where `mask` is set and from `student` (detached) elsewhere; masked out elsewhere.
torch::Tensor denoising_loss(DepthNetwork& network, const torch::Tensor& condition,
                             const torch::Tensor& target, const torch::Tensor& student,
                             const torch::Tensor& mask, const torch::Tensor& weight,
                             const DenoisingDraw& draw);

// What a step trains: everything, or encoder, decoder and the 0-step answer alone, which is
// cheaper and does not ask an untrained decoder to steer the head.
enum class Part : std::uint8_t { kWhole, kDirect };

// One pass of network and losses over normalised rgb [B, 3, H, W].
Losses training_losses(DepthNetwork& network, const torch::Tensor& rgb, const Target& target,
                       const LossWeights& weights, Part part, at::Generator& generator);

}  // namespace lcdm::model
