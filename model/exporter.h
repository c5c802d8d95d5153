// From training weights to the model file of NETWORK.md.
#pragma once

#include <string>

#include "firmware/base/status.h"
#include "model/network.h"

namespace lcdm::model {

// The inference weights of `network`, normalisation and time embedding folded, by the file's names.
// The 0-step convolution is left out.
std::map<std::string, torch::Tensor> fold_network(const DepthNetwork& network);

// Writes `network` in half precision with its configuration as metadata.
Status export_network(const DepthNetwork& network, const std::string& path);

}  // namespace lcdm::model
