// From a model file back to a network that can be trained on: what exporter.h folded, undone.
#pragma once

#include <string>

#include "firmware/base/status.h"
#include "model/network.h"

namespace lcdm::model {

// The network of the model file at `path`, in evaluation mode; it computes the same depth. What the
// file no longer says is chosen so: batch norms have no statistics of their own (mean 0, variance
// 1; measure_statistics before training); every time has the embedding of the nearest sampler step;
// the 0-step convolution is zero (fit_direct before training); filters before a norm are as large
// as new ones. Errors as ModelFile and Network::check_weights.
Result<DepthNetwork> unfold_model(const std::string& path);

// Whether the file at `path` is a training checkpoint rather than a model file. Errors as
// read_tensors.
Result<bool> is_checkpoint(const std::string& path);

}  // namespace lcdm::model
