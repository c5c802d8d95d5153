// A training of a few steps on rendered frames, for tests of the loop.
#pragma once

#include <gtest/gtest.h>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "model/checkpoint.h"
#include "model/replicas.h"
#include "model/safetensors.h"
#include "model/scene_pack.h"
#include "model/trainer.h"
#include "tests/support/temporary_folder.h"

namespace lcdm::model {

inline const std::vector<Pack>& scene_packs() {
  static const std::vector<Pack> packs = [] {
    ScenePackOptions options;
    options.train_frames = 24;
    options.validation_frames = 8;
    return std::vector<Pack>{rendered_pack(options)};
  }();
  return packs;
}

inline Recipe small_recipe() {
  Recipe recipe;
  recipe.encoder = EncoderKind::kXxs;
  recipe.steps = 6;
  recipe.stages = {{0.25, 2, 1}};
  recipe.head_from = 0;
  recipe.warm_up = 2;
  return recipe;
}

inline bool same_weights(Trainer& a, Trainer& b) {
  std::map<std::string, torch::Tensor> left;
  std::map<std::string, torch::Tensor> right;
  collect(*a.averaged(), "", left);
  collect(*b.averaged(), "", right);
  for (const auto& [name, tensor] : left) {
    if (!torch::equal(tensor, right[name])) return false;
  }
  return true;
}

// All that a training is made of: weights, optimiser, counters.
inline std::map<std::string, torch::Tensor> state_of(const Trainer& trainer) {
  const test::TemporaryFolder folder;
  const std::string path = folder.file("checkpoint.safetensors");
  EXPECT_TRUE(trainer.save(path));
  const Result<TensorFile> file = read_tensors(path);
  EXPECT_TRUE(file) << file.status().text();
  return file->tensors;
}

inline std::unique_ptr<Trainer> trainer_of(const Recipe& recipe,
                                           const std::vector<Pack>& packs = scene_packs()) {
  auto trainer = Trainer::make(recipe, packs, one_cpu());
  EXPECT_TRUE(trainer) << trainer.status().text();
  return std::move(*trainer);
}

// Views of rendered worlds, all different, stand in for a drive: every second frame, which are
// wide.
inline Pack as_video(Pack pack) {
  std::vector<PackFrame> frames;
  for (std::size_t i = 0; i < pack.frames->size(); ++i) {
    frames.push_back(*pack.frames->read(2 * i % pack.frames->size()));
    frames.back().name = std::to_string(i);
  }
  pack.frames = std::make_shared<MemoryFrames>(std::move(frames), true);
  return pack;
}

}  // namespace lcdm::model
