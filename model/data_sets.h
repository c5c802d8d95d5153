// What commands train, validate and test on: the sets that a catalogue names, opened.
#pragma once

#include <CLI/CLI.hpp>
#include <optional>
#include <string>
#include <vector>

#include "firmware/base/status.h"
#include "model/metrics.h"
#include "model/pack.h"

namespace lcdm::model {

// What commands ask about their data.
struct DataOptions {
  std::string catalogue = "model/data/research.toml";
  std::string root;                // instead of the catalogue's
  std::vector<std::string> packs;  // folders to train on instead of the catalogue's
  bool video = false;              // those are
  std::size_t every = 1;           // n-th frame of each pack
  std::optional<std::size_t> scene_frames;
};
void add_data_options(CLI::App& command, DataOptions& options);
// --test, for a command that has those.
void add_test_option(CLI::App& command, bool& test);

struct Data {
  std::string licence;
  std::vector<Pack> packs;
  std::vector<Protocol> protocols;  // of each pack
};
// The training packs, each split into training and validation, the renderings last.
Result<Data> load_training_data(const DataOptions& options);
// The test sets; every frame of theirs is in `validation`, at its full size.
Result<Data> load_test_data(const DataOptions& options);

// kUsage: no set has a frame to measure on; `test`: they are the test sets.
Status require_frames(const Data& data, bool test);

}  // namespace lcdm::model
