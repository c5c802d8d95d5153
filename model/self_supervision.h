// What neighbouring frames of a drive teach without any depth (Monodepth2, arXiv 1806.01260).
#pragma once

#include <vector>

#include "model/torch.h"

namespace lcdm::model {

// Structural similarity over 3x3 windows, 0 (alike) to 1, [B, C, H, W].
torch::Tensor structural_difference(const torch::Tensor& x, const torch::Tensor& y);

// Equation 6's pe: .85 structural difference + .15 L1, mean over the channels, [B, 1, H, W].
torch::Tensor photometric_error(const torch::Tensor& estimate, const torch::Tensor& target);

// Equation 6 with minimum reprojection and auto-mask: of every pixel the least error over the
// warped neighbours and over the neighbours as they stand (plus a draw of at most 1e-5 or so that
// breaks ties); a pixel that needs no motion teaches nothing. Mean over the images, each times
// its `weight` [B]. Scalar.
torch::Tensor photometric_loss(const torch::Tensor& target,
                               const std::vector<torch::Tensor>& warped,
                               const std::vector<torch::Tensor>& neighbours,
                               const torch::Tensor& weight, at::Generator& generator);

// Equation 7: the first differences of inverse depth, divided by its mean, where the picture has
// none. inverse_depth [B, 1, H, W], image [B, 3, H, W]. Scalar.
torch::Tensor smoothness_loss(const torch::Tensor& inverse_depth, const torch::Tensor& image);

}  // namespace lcdm::model
