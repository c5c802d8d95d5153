// Muon (Jordan et al. 2024; scaled as in arXiv 2502.16982): the update of a matrix is its momentum
// with all singular values made nearly one, so that no direction of the gradient is drowned out by
// the few that are strongest. Ours for the reason that AdamW is: checkpoints resume bit-exactly.
#pragma once

#include "model/torch.h"

namespace lcdm::model {

// `matrix` [rows, columns] with its singular values brought to about 1 and its singular vectors
// kept, by five steps of a Newton-Schulz iteration.
torch::Tensor orthogonalised(const torch::Tensor& matrix);

// At least 8 x 16 numbers as [outputs, the rest]: weights of convolutions and linear layers.
// Depthwise filters, biases, norms and the last convolution are not.
bool is_matrix(const torch::Tensor& parameter);

// The change of a parameter for a learning rate of 1; `momentum` takes the gradient in. Its size is
// that of AdamW's changes, so one learning rate serves both.
torch::Tensor muon_update(const torch::Tensor& gradient, torch::Tensor& momentum);

}  // namespace lcdm::model
