// What decides the weights besides the data: network, stages, rates and losses of a training.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/nn/network_config.h"
#include "model/losses.h"
#include "model/optimizer.h"

namespace lcdm::model {

// The deployed sizes, wide and 4:3 (NETWORK.md).
inline constexpr int kDeployed[2][2] = {{640, 192}, {256, 192}};
inline constexpr float kCanonicalFocal = 320;  // pixels, at these sizes

// `share` of a side, to the nearest multiple of 32 that a network can have.
int scaled_side(int side, double share);

// A part of the training: the size of its pictures and how many make a batch.
struct Stage {
  double share = 1;          // of the deployed size
  int images = 4;            // of a wide batch; one of smaller pictures has more (make_shapes)
  double until = 1;          // share of the steps at which the next stage begins
  double learning_rate = 0;  // > 0: warm-up and cosine begin again here, from this rate
};
// "SHARE:IMAGES:UNTIL" or "SHARE:IMAGES:UNTIL:RATE". kUsage: not numbers in their ranges.
Result<Stage> parse_stage(const std::string& text);

// A file of model/recipes/.
struct Recipe {
  EncoderKind encoder = EncoderKind::kXs;
  PresetKind preset = PresetKind::kLcdm;
  std::optional<StartKind> start;  // none: that of the weights it starts from, or noise
  std::uint64_t seed = 1;
  std::int64_t steps = 1000;
  std::vector<Stage> stages = {{0.5, 8, 0.8}, {1, 4, 1}};  // the last runs to the end
  double head_from = 0.4;    // share of the steps before which only the 0-step answer is trained
  double freeze_from = 0.5;  // and after which batch-norm statistics stay as they are
  int accumulate = 1;        // batches of an optimiser step
  int workers = 2;           // threads that share a batch; batch norm sees a worker's part only
  bool bf16 = false;         // encoder and decoder in bfloat16
  OptimizerKind optimizer = OptimizerKind::kAdamW;
  double learning_rate = 1e-3;  // at its highest, where no stage names its own
  double final_rate = 5e-6;     // at the end of each cosine
  std::int64_t warm_up = 100;
  double weight_decay = 1e-2;
  double clip = 5;
  double average = 0.998;  // of the exponential moving average of the weights
  LossWeights losses;
};

// All of it, one "name = value" a line: equal texts train alike.
std::string recipe_text(const Recipe& recipe);

// The first step at or after `share` of them.
std::int64_t first_step(const Recipe& recipe, double share);

// Index of the stage that `step` belongs to.
std::size_t stage_at(const Recipe& recipe, std::int64_t step);

// Warm-up, then a cosine to the next stage that names a rate, or to the end.
double learning_rate_at(const Recipe& recipe, std::int64_t step);

// The head's: as above, but where it joins later than that it begins there. By then the others'
// rate is nearly at its end.
double head_rate_at(const Recipe& recipe, std::int64_t step);

// The network that a recipe trains, before its data is known.
ModelConfig model_config_of(const Recipe& recipe);

}  // namespace lcdm::model
