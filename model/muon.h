// Muon (Jordan et al. 2024; scaled as in arXiv 2502.16982): the update of a matrix is its momentum
// with all singular values made nearly one, so that no direction of the gradient is drowned out by
// the few that are strongest. Ours for the reason that AdamW is: checkpoints resume bit-exactly.
#pragma once

#include <vector>

#include "model/torch.h"

namespace lcdm::model {

// `matrices` [n, rows, columns] with the singular values of each brought to about 1 and its
// singular vectors kept, by five steps of a Newton-Schulz iteration.
torch::Tensor orthogonalised(const torch::Tensor& matrices);

// At least 8 x 16 numbers as [outputs, the rest]: weights of convolutions and linear layers.
// Depthwise filters, biases, norms and the last convolution are not.
bool is_matrix(const torch::Tensor& parameter);

// The changes of parameters for a learning rate of 1; their `momenta` take the `gradients` in. All
// are the same matrix's shape as [outputs, the rest]: they go through the iteration together, since
// a product each keeps no GPU busy. A change's size is that of AdamW's, so one learning rate serves
// both.
std::vector<torch::Tensor> muon_updates(const std::vector<torch::Tensor>& gradients,
                                        const std::vector<torch::Tensor>& momenta);

}  // namespace lcdm::model
