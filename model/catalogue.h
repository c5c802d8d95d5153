// The catalogue: one TOML file that says which data a network is trained, validated and tested on,
// in what mixture, and what licence follows for the weights (model/data/).
#pragma once

#include <CLI/CLI.hpp>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "firmware/base/status.h"
#include "model/metrics.h"
#include "model/pack.h"

namespace lcdm::model {

// One data set of the catalogue.
struct CatalogueEntry {
  enum class Form : std::uint8_t { kPack, kKittiRaw, kNyu, kMake3d } form = Form::kPack;
  std::string path;  // below the catalogue's root
  PackUse use;
  Protocol protocol;
  std::string list;             // KITTI: which frames
  std::string validation_list;  // KITTI: which of them validate; empty: every tenth of `list`
  std::string ground_truth;     // KITTI: "velodyne", or the folder of the improved ground truth
};

// How much of a rendering.
struct RenderedUse {
  std::size_t frames = 0;
  float wide_share = 1;
  float tall_share = 1;
};

struct Catalogue {
  std::string licence;  // of weights trained on it
  std::string root;
  std::vector<CatalogueEntry> train;
  std::vector<CatalogueEntry> test;
  RenderedUse scene;
  RenderedUse medley;
};

// Errors name file, line and key: kInvalidInput.
Result<Catalogue> read_catalogue(const std::string& file);

// What commands ask about their data.
struct DataOptions {
  std::string catalogue = "model/data/research.toml";
  std::string root;                // instead of the catalogue's
  std::vector<std::string> packs;  // folders to train on instead of the catalogue's
  std::size_t every = 1;           // n-th frame of each pack
  std::optional<std::size_t> scene_frames;
};
void add_data_options(CLI::App& command, DataOptions& options);

struct Data {
  std::string licence;
  std::vector<Pack> packs;
  std::vector<Protocol> protocols;  // of each pack
};
// The training packs, each split into training and validation, the renderings last.
Result<Data> load_training_data(const DataOptions& options);
// The test sets; every frame of theirs is in `validation`, at its full size.
Result<Data> load_test_data(const DataOptions& options);

}  // namespace lcdm::model
