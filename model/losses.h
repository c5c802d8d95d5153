// The losses of LCDM-Mono (paper section 3.2), masked: invalid pixels count for nothing.
#pragma once

#include <torch/types.h>

namespace lcdm::model {

// All tensors [batch, 1, H, W] float; `valid` is bool. A batch without a valid pixel gives 0 with
// gradients intact.

// Mean of value over valid pixels.
torch::Tensor masked_mean(const torch::Tensor& value, const torch::Tensor& valid);

// Eq. 8: squared error of the predicted noise (or v).
torch::Tensor denoising_loss(const torch::Tensor& prediction, const torch::Tensor& target,
                             const torch::Tensor& valid);

// Eq. 9, preset lcdm: L1 on log depth.
torch::Tensor log_depth_loss(const torch::Tensor& depth, const torch::Tensor& teacher,
                             const torch::Tensor& valid);

// Eq. 9, preset paper: L1 on depth.
torch::Tensor depth_loss(const torch::Tensor& depth, const torch::Tensor& teacher,
                         const torch::Tensor& valid);

// L1 between the gradients of log depth at four scales (Li and Snavely, MegaDepth 2018, Eq. 4):
// edges as sharp as the teacher's, whatever the scale. A difference counts where both its pixels
// are valid.
torch::Tensor gradient_loss(const torch::Tensor& depth, const torch::Tensor& teacher,
                            const torch::Tensor& valid);

// The factor per image that brings the teacher's median to the student's, over valid pixels:
// [batch, 1, 1, 1], detached. 1 for an image without valid pixels.
torch::Tensor median_ratio(const torch::Tensor& student, const torch::Tensor& teacher,
                           const torch::Tensor& valid);

}  // namespace lcdm::model
