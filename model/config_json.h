// The model file's metadata as text (NETWORK.md, "The model file").
#pragma once

#include <string>

#include "firmware/nn/network_config.h"

namespace lcdm::model {

// What parse_model_config reads back as `config`. Its error where it would not: nothing is written
// that cannot be read.
Result<std::string> config_json(const ModelConfig& config);

}  // namespace lcdm::model
