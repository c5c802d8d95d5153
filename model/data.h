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
  std::vector<std::string> packs;  // folders to train on instead of those in `root`
  std::size_t every = 1;           // n-th frame of each pack
  std::size_t scene_frames = 400;
};

void add_data_options(CLI::App& command, DataOptions& options);

// All training packs, the rendered scene last. Errors as load_pack.
Result<std::vector<Pack>> load_training_data(const DataOptions& options);

}  // namespace lcdm::model
