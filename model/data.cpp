#include "model/data.h"

#include <filesystem>

#include "model/scene_pack.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;

constexpr int kMaxWidth = 640;

// A pack of the user's own: trusted, for both shapes alike.
PackUse own_pack(const std::string& name) {
  PackUse use;
  use.name = name;
  use.wide_share = use.tall_share = 1;
  return use;
}

}  // namespace

void add_data_options(CLI::App& command, DataOptions& options) {
  command.add_option("--data", options.root, "Folder of the packs")->capture_default_str();
  command.add_option("--every", options.every, "Keep every n-th frame of a pack")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command.add_option("--scene-frames", options.scene_frames, "Rendered training frames")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  command
      .add_option("--pack", options.packs,
                  "Train on this pack (rgb/, depth/, intrinsics.json) instead of those of --data; "
                  "may be given again")
      ->check(CLI::ExistingDirectory);
}

Result<std::vector<Pack>> load_training_data(const DataOptions& options) {
  std::vector<Pack> packs;
  const auto load = [&](const fs::path& root, const PackUse& use) -> Status {
    Result<Pack> pack = load_pack(root, use, kMaxWidth, options.every);
    if (!pack) return pack.status();
    packs.push_back(std::move(*pack));
    return Status::ok();
  };
  for (const std::string& folder : options.packs) {
    const fs::path path = fs::canonical(folder);
    LCDM_RETURN_IF_ERROR(load(path.parent_path(), own_pack(path.filename().string())));
  }
  if (options.packs.empty()) {
    for (const PackUse& use : training_packs()) LCDM_RETURN_IF_ERROR(load(options.root, use));
  }
  if (options.scene_frames == 0) return packs;
  ScenePackOptions scene;
  scene.train_frames = options.scene_frames;
  packs.push_back(render_scene_pack(scene));
  return packs;
}

}  // namespace lcdm::model
