// What training minimises. Tensors are [B, 1, H, W]; masks are bool of the same shape; every loss
// is a scalar with gradients to its first argument.
#pragma once

#include <array>

#include "firmware/nn/network_config.h"
#include "model/pack.h"
#include "model/torch.h"
#include "model/trained_networks.h"
#include "model/training_batch.h"

namespace lcdm::model {

// Equation 11 and what we added to it.
struct LossWeights {
  double distillation = 1;
  double denoising = 1;
  double normals = 0;      // 1 in the paper
  double photometric = 0;  // 1 in the paper; needs neighbouring frames and the pose network
  double smoothness = 0;   // 1e-3 in the paper
  double gradient = 0.5;   // multi-scale matching of log-depth gradients; ours
  double direct = 0.5;     // the 0-step output's share of all losses on depth; ours
};

enum class Term : std::uint8_t {
  kDistillation,
  kDenoising,
  kNormals,
  kPhotometric,
  kSmoothness,
  kGradient,
  kDirect,
};
inline constexpr std::array<const char*, 7> kTermNames = {
    "distillation", "denoising", "normals", "photometric", "smoothness", "gradient", "direct"};

struct Losses {
  torch::Tensor total = torch::zeros({});  // with gradients
  std::array<double, kTermNames.size()> terms{};

  double& operator[](Term term) { return terms[static_cast<std::size_t>(term)]; }
  double operator[](Term term) const { return terms[static_cast<std::size_t>(term)]; }
  Losses times(double factor) const;
  void add(const Losses& other);  // takes no gradients over
};

// Mean over the images of weight times the mean of |error| over its mask, 0 for one without a valid
// pixel. A weight of half is half the gradient, whatever else is in the batch.
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

// log_target brought to the student, who gets no gradient from it. `alignment` [B] int64 says how:
// kScale moves an image so that its median error is 0; kAffine gives its inverse depth the mean and
// the deviation of the student's (a quarter of the mean at least), and falls back to kScale where
// that would be no depth: near turned into far, or more than a few pixels beyond the farthest.
// Either way its median stays within two deviations of the diffusion variable's mean.
torch::Tensor align_to_student(const torch::Tensor& log_target, const torch::Tensor& log_depth,
                               const torch::Tensor& mask, const torch::Tensor& alignment,
                               const ModelConfig& config);

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

// Surface-normal distillation: mean squared distance of the unit normals of two depths, where both
// windows are valid. Windows of 5x5 neighbouring pixels for `lcdm`, 9x9 four apart for `paper`.
torch::Tensor normal_loss(const torch::Tensor& depth, const torch::Tensor& target_depth,
                          const torch::Tensor& mask, const torch::Tensor& weight,
                          const Pinholes& cameras, PresetKind preset);

// One pass of the networks and losses over a batch.
Losses training_losses(TrainedNetworks& networks, const Batch& batch, const LossWeights& weights,
                       Part part, at::Generator& generator);

}  // namespace lcdm::model
