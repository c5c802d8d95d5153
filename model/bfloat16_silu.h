// SiLU of bfloat16 tensors on processors.
#pragma once

#include "model/torch.h"

namespace lcdm::model {

// x / (1 + e^-x), any shape, differentiable once. LibTorch's own, but for bfloat16 on a processor,
// where LibTorch 1.13 takes more than three times as long as for floats: there the floats are made
// in registers, and what comes out is rounded once (to nearest).
torch::Tensor silu_of(const torch::Tensor& x);

}  // namespace lcdm::model
