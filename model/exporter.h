// From training weights to the model file of NETWORK.md.
#pragma once

#include <string>
#include <vector>

#include "firmware/base/status.h"
#include "model/network.h"

namespace lcdm::model {

// The inference weights of `network`, normalisation and time embedding folded, by the file's names.
// The 0-step convolution is left out.
std::map<std::string, torch::Tensor> fold_network(const DepthNetwork& network);

// Writes `network` in half precision with its configuration as metadata.
Status export_network(const DepthNetwork& network, const std::string& path);

// The same of the mean of several networks' weights and statistics, with the first one's name,
// licence and card. They are to be states of one training, or of one that went on from the other:
// there the mean is often better than each. kInvalidInput: none, or networks that do not compute
// alike.
Status export_mean(const std::vector<DepthNetwork>& networks, const std::string& path);

}  // namespace lcdm::model
