#include "model/data.h"

namespace lcdm::model {
namespace {

constexpr int kMaxWidth = 640;

}  // namespace

void add_data_options(CLI::App& command, DataOptions& options) {
  command.add_option("--data", options.root, "Folder of the packs")->capture_default_str();
  command.add_option("--every", options.every, "Keep every n-th frame of a pack")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
}

Result<std::vector<Pack>> load_training_data(const DataOptions& options) {
  std::vector<Pack> packs;
  for (const PackUse& use : training_packs()) {
    Result<Pack> pack = load_pack(options.root, use, kMaxWidth, options.every);
    if (!pack) return pack.status();
    packs.push_back(std::move(*pack));
  }
  return packs;
}

}  // namespace lcdm::model
