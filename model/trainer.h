// The training loop: batches in, a checkpoint and a log out.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <string>
#include <torch/types.h>
#include <vector>

#include "firmware/base/status.h"
#include "model/depth_net.h"
#include "model/training_step.h"

namespace lcdm::model {

struct TrainOptions {
  std::string output;  // folder for checkpoint.pt and log.csv
  std::int64_t steps = 10000;
  int batch_size = 8;
  std::vector<std::array<int, 2>> shapes = {{320, 96}, {256, 192}};
  double learning_rate = 1e-3;
  double last_learning_rate = 1e-5;
  std::int64_t warmup_steps = 200;
  double weight_decay = 1e-2;
  double clip_norm = 1;
  double freeze_norm_at = 0.8;  // share of the steps after which batch statistics stay
  std::int64_t checkpoint_every = 500;
  std::uint64_t seed = 1;
  LossWeights weights;
};

// The learning rate of a step: linear warm-up, then cosine to the last rate.
double learning_rate_at(const TrainOptions& options, std::int64_t step);

// Trains `net` on `sources`, from its checkpoint in options.output when there is one: the run then
// continues bit for bit as if it had not stopped (on a CPU with the same number of threads).
// Stops with an error, the last checkpoint intact, when the loss is no number or the disk refuses.
// `stop_requested` is asked after every step; true saves a checkpoint and returns.
Status train(DepthNet& net, const std::vector<Source>& sources, const TrainOptions& options,
             const std::function<bool()>& stop_requested);

// Written whole or not at all: to a file beside `path`, then renamed over it.
Status save_atomically(const std::string& path,
                       const std::function<void(const std::string&)>& write);

}  // namespace lcdm::model
