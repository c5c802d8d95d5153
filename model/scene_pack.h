// The rendered scene as a pack: exact depth for training, and unseen worlds to validate on.
#pragma once

#include <cstdint>

#include "model/pack.h"

namespace lcdm::model {

// The scene's worlds at any moment, or medleys: things of every kind anywhere, seen from anywhere.
enum class Rendering : std::uint8_t { kScene, kMedley };

struct ScenePackOptions {
  Rendering rendering = Rendering::kScene;
  std::uint64_t train_seed = 1000;  // first of the training worlds' seeds
  std::size_t train_frames = 400;   // four of each world; each medley gives one
  std::uint64_t validation_seed = 900000;
  std::size_t validation_frames = 40;
  int photographs = 0;  // that medleys to train on are painted with (photographs.h)
  float wide_share = 1;
  float tall_share = 1;
};

// Frames of alternating shape (384x288, 640x192), moments and fields of view drawn by the seed,
// rendered whenever they are read. The sky's depth is kSkyDepth.
Pack rendered_pack(const ScenePackOptions& options);

// More training frames than these would show the worlds that validate.
inline constexpr std::size_t kMostRenderedFrames = 4 * (900000 - 1000);

// Metres: far beyond what the network can say, so that it learns "farthest".
inline constexpr float kSkyDepth = 1000;

}  // namespace lcdm::model
