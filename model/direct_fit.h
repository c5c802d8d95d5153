// A 0-step answer for a network whose file holds none.
#pragma once

#include <vector>

#include "model/network.h"

namespace lcdm::model {

// Gives `direct` the 3x3 convolution whose answers are nearest, in squares, to those of the sampler
// over `pictures` (batches of normalised RGB). In evaluation mode.
void fit_direct(DepthNetwork& network, const std::vector<torch::Tensor>& pictures);

}  // namespace lcdm::model
