// A model file as an ONNX graph, for other runtimes: to compare the engine with and to carry the
// network to accelerators.
#pragma once

#include <string>

#include "firmware/base/status.h"
#include "firmware/nn/model_file.h"

namespace lcdm::model {

// Writes the network of `file` for one input size: `image` [1, 3, height, width], normalised as in
// NETWORK.md, to `depth` [1, 1, height, width] at the canonical focal length, both float32. Made
// from the same layer list as the engine's program; the sampler is unrolled and its start is a
// constant. kInvalidInput: the size or the file does not fit the network.
Status export_onnx(const ModelFile& file, int width, int height, const std::string& path);

}  // namespace lcdm::model
