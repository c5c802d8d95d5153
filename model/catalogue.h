// The catalogue: one TOML file that says which data a network is trained, validated and tested on,
// in what mixture, and what licence follows for the weights (model/data/).
#pragma once

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
  bool says_align = false;  // otherwise the maps' teacher.json does
  Protocol protocol;
  std::string list;             // KITTI: which frames
  std::string validation_list;  // KITTI: which of them validate; needed to train on it
  std::string ground_truth;     // KITTI: "velodyne", or the folder of the improved ground truth
};

// How much of a rendering.
struct RenderedUse {
  std::size_t frames = 0;
  float wide_share = 1;
  float tall_share = 1;
  int photographs = 0;  // medleys: cut from the training pictures as further paint
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

}  // namespace lcdm::model
