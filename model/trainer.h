// The training loop's state and steps; prints nothing.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "firmware/base/status.h"
#include "model/adamw.h"
#include "model/batch.h"
#include "model/losses.h"
#include "model/trained_networks.h"
#include "model/weight_import.h"

namespace lcdm::model {

// Everything that decides the weights besides the data; a file of model/recipes/.
struct Recipe {
  EncoderKind encoder = EncoderKind::kXs;
  PresetKind preset = PresetKind::kLcdm;
  StartKind start = StartKind::kNoise;
  std::uint64_t seed = 1;
  std::int64_t steps = 1000;
  double reduced = 0.5;      // first part trains at this share of the deployed size
  double head_from = 0.4;    // share of the steps before which only the 0-step answer is trained
  double full_from = 0.8;    // after which it trains at the deployed size
  double freeze_from = 0.5;  // and after which batch-norm statistics stay as they are
  int images = 8;            // of a batch at the reduced size
  int full_images = 4;       // and at the deployed size
  int workers = 2;           // threads that share a batch; batch norm sees a worker's part only
  double learning_rate = 1e-3;
  double final_rate = 5e-6;
  std::int64_t warm_up = 100;
  double weight_decay = 1e-2;
  double clip = 5;
  double average = 0.998;  // of the exponential moving average of the weights
  LossWeights losses;
};

// The deployed sizes, wide and 4:3 (NETWORK.md).
inline constexpr int kDeployed[2][2] = {{640, 192}, {384, 288}};

class Trainer {
 public:
  // Measures the variable's mean and deviation on `packs`, which must outlive the trainer.
  Trainer(const Recipe& recipe, const std::vector<Pack>& packs);

  std::int64_t step() const { return step_; }
  bool done() const { return step_ >= recipe_.steps; }
  std::int64_t images() const { return images_; }
  // Of all but the head, which has the same curve from where it joins.
  double learning_rate() const;
  // One optimiser step. kCorrupt where the loss or a gradient is not finite: what and when; the
  // weights are then those before the step.
  Result<Losses> advance();

  // Starts encoder or pose network from others' weights; before the first step. Errors as
  // weight_import.h; kInvalidInput where there is no pose network.
  Result<ImportReport> start_encoder_from(const TensorFile& file, ChannelOrder order);
  Result<ImportReport> start_pose_from(const TensorFile& file);

  // The averaged weights, in evaluation mode.
  DepthNetwork& averaged() { return average_; }
  const ModelConfig& config() const { return networks_->depth->config; }

  Status save(const std::string& path) const;
  // kInvalidInput: the checkpoint is of another network. The recipe's steps may differ.
  Status resume(const std::string& path);

 private:
  bool past(double share) const;
  // Warm-up, then a cosine to the end, begun at step `first`.
  double rate_after(double first) const;
  void set_modes();
  // Losses and gradients of one worker's part of the batch; its share weighs them.
  Losses run_worker(std::size_t worker, const Batch& part, double share);
  // Sums the workers' gradients and averages their statistics into worker 0.
  void gather_workers();
  void update_average();
  std::vector<BatchShape> shapes() const;

  Recipe recipe_;
  const std::vector<Pack>& packs_;
  TrainedNetworks networks_ = nullptr;  // also worker 0's
  // Of the other workers: the same weights in memory, gradients and statistics of their own.
  std::vector<TrainedNetworks> replicas_;
  DepthNetwork average_ = nullptr;
  std::unique_ptr<AdamW> optimizer_;
  std::unique_ptr<BatchLoader> loader_;
  bool full_size_ = false;  // what loader_ makes
  std::int64_t step_ = 0;
  std::int64_t images_ = 0;
};

// Weights and buffers of `network` by name, with `prefix`.
void collect(const torch::nn::Module& network, const std::string& prefix,
             std::map<std::string, torch::Tensor>& tensors);
// The reverse; false where one is missing or of another shape.
bool restore(torch::nn::Module& network, const std::string& prefix,
             const std::map<std::string, torch::Tensor>& tensors);

// The averaged network of a checkpoint, for evaluation and export.
Result<DepthNetwork> load_checkpoint(const std::string& path);

}  // namespace lcdm::model
