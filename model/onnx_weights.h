// The weights of an ONNX file that others wrote (github.com/onnx/onnx, onnx.proto).
#pragma once

#include <map>
#include <string>
#include <vector>

#include "firmware/base/status.h"
#include "model/torch.h"

namespace lcdm::model {

// Every operator's constant inputs that are kept in the file as floats, in order, by the operator's
// name. kInvalidInput: no such file, or not an ONNX file; names it.
Result<std::map<std::string, std::vector<torch::Tensor>>> read_onnx_weights(
    const std::string& path);

}  // namespace lcdm::model
