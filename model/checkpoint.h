// Networks as named tensors, and back out of a training's checkpoint.
#pragma once

#include <map>
#include <string>

#include "firmware/base/status.h"
#include "model/network.h"

namespace lcdm::model {

// Weights and buffers of `network` by name, with `prefix`.
void collect(const torch::nn::Module& network, const std::string& prefix,
             std::map<std::string, torch::Tensor>& tensors);
// The reverse; false where one is missing or of another shape.
bool restore(torch::nn::Module& network, const std::string& prefix,
             const std::map<std::string, torch::Tensor>& tensors);

// The averaged network of a checkpoint, for evaluation and export.
Result<DepthNetwork> load_checkpoint(const std::string& path);

}  // namespace lcdm::model
