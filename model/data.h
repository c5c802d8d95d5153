// Which data a command works on: the shared packs and the rendered scene.
#pragma once

#include <CLI/CLI.hpp>
#include <string>
#include <vector>

#include "firmware/base/status.h"
#include "model/pack.h"

namespace lcdm::model {

struct DataOptions {
  std::string root = "../shared/data";
  std::size_t every = 1;  // n-th frame of each pack
};

void add_data_options(CLI::App& command, DataOptions& options);

// All training packs. kNotFound: none is there.
Result<std::vector<Pack>> load_training_data(const DataOptions& options);

}  // namespace lcdm::model
