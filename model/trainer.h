// The training loop's state and steps; prints nothing.
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "firmware/base/status.h"
#include "model/batch.h"
#include "model/divergence.h"
#include "model/losses.h"
#include "model/optimizer.h"
#include "model/phase.h"
#include "model/processes.h"
#include "model/recipe.h"
#include "model/replicas.h"
#include "model/trained_networks.h"
#include "model/weight_import.h"

namespace lcdm::model {

// Of trained weights' batch norms: a model file's have been folded away.
enum class NormStatistics : std::uint8_t { kKept, kMissing };

// Where training happens.
struct Compute {
  torch::Device device = torch::kCPU;
  std::shared_ptr<Processes> processes;  // not null
  std::size_t loaders = 2;               // batches made at once
};
// This machine's CPU, alone.
Compute one_cpu();

// What a pack's camera turned out to be.
struct LearnedFocal {
  std::string pack;
  double fx = 1, fy = 1;  // over the assumed ones
};

class Trainer {
 public:
  // Measures the variable's mean and deviation on `packs`, which must outlive the trainer. Errors
  // as make_batch; kInvalidInput: the recipe contradicts itself.
  static Result<std::unique_ptr<Trainer>> make(const Recipe& recipe, const std::vector<Pack>& packs,
                                               const Compute& compute);

  std::int64_t step() const { return step_; }
  bool done() const { return step_ >= recipe_.steps; }
  // Pictures seen, by all processes.
  std::int64_t images() const { return images_; }
  // By this process since it began.
  const DrawnFrames& frames() const { return frames_; }
  // Of all but the head.
  double learning_rate() const { return learning_rate_at(recipe_, step_); }
  // Whether the newest step trained the head (before the first one: whether that will).
  bool has_head() const { return newest_phase().head; }
  // One optimiser step. kCorrupt where too many frames cannot be read (batch.h), where the loss or
  // a gradient is not finite, or losses stay far above what they were (divergence.h): what and
  // when; kUnavailable where another process has gone. Weights and statistics are then those before
  // the step.
  Result<Losses> advance();

  // Starts the depth network from weights trained before, also of a smaller encoder (widener.h);
  // before the first step. Their licence comes with them, and their sampler's start where the
  // recipe names none; with `kMissing`, and in a wider network, the batch norms' statistics are
  // measured on the first samples, and a missing 0-step answer is fitted to the sampler's there.
  // kInvalidInput: another preset or shape, a larger encoder; errors
  // as make_batch.
  Status start_from(const DepthNetwork& trained, NormStatistics statistics);
  // Starts encoder or pose network from others' weights; before the first step. A licence that the
  // encoder's file names comes with it. The encoder's
  // statistics are measured: theirs are of pictures scaled in another way. Errors as
  // weight_import.h and make_batch; kUsage where there is no pose network.
  Result<ImportReport> start_encoder_from(const TensorFile& file, ChannelOrder order);
  Result<ImportReport> start_pose_from(const TensorFile& file);

  // Size of the newest step's pictures as a share of the deployed size.
  double share() const { return recipe_.stages[newest_phase().stage].share; }
  // Remembers the best validation score (lower is better), over checkpoints too. Whether it is the
  // best so far of the networks with as much of a head and of this size.
  bool update_best(double score);

  // The averaged weights, in evaluation mode.
  DepthNetwork& averaged() { return average_; }
  const ModelConfig& config() const { return networks_->depth->config; }
  // By now, of the packs whose intrinsics are learned.
  std::vector<LearnedFocal> learned_focals() const;
  // What the data asks of the weights; kept in the checkpoint. kInvalidInput: the device would not
  // read such a text.
  Status set_licence(const std::string& licence);

  Status save(const std::string& path) const;
  // kInvalidInput: the checkpoint is of another network. What else differs between its training and
  // this one (steps, rates, losses, data) holds from here on and is returned, in lines; empty:
  // nothing.
  Result<std::string> resume(const std::string& path);

 private:
  Trainer(const Recipe& recipe, const std::vector<Pack>& packs, const Compute& compute,
          const ModelConfig& config);

  bool past(double share) const;  // of the steps
  Phase phase_at(std::int64_t step) const;
  // What the averaged weights were trained as: a score is of these, not of what comes next.
  Phase newest_phase() const { return phase_at(step_ > 0 ? step_ - 1 : 0); }
  // Samples of the present stage, [B, 3, H, W] each, on the device.
  Result<std::vector<torch::Tensor>> sample_pictures() const;
  // The batch-norm statistics of `part` of the depth network, on samples of the present stage.
  Status measure(torch::nn::Module& part, Answers answers);
  // The head's, where it joins after statistics are frozen, so that nothing has gone through it, or
  // so shortly before that they are mostly how they were made.
  Status measure_new_head();
  bool freezes_a_young_head() const;
  // The average and the replicas become what `networks_` is.
  void spread_weights();
  // As advance, but a fault may leave statistics of half a step.
  Result<Losses> take_step();
  void prepare_loader();
  void set_modes();
  // Losses and gradients of batch `k` of this step, shared among the workers.
  Losses run_batch(const Batch& batch, int k);
  // Of one worker's part of it; its share of the whole step weighs them.
  Losses run_worker(int worker, int k, const Batch& part, double share);
  void update_average();

  Recipe recipe_;
  const std::vector<Pack>& packs_;
  Compute compute_;
  TrainedNetworks networks_ = nullptr;
  std::unique_ptr<Replicas> replicas_;  // of networks_, which is worker 0's too
  DepthNetwork average_ = nullptr;
  std::unique_ptr<Optimizer> optimizer_;
  std::unique_ptr<BatchLoader> loader_;
  std::size_t loader_stage_ = 0;  // what loader_ makes
  std::int64_t step_ = 0;
  std::int64_t images_ = 0;
  DrawnFrames frames_;
  Divergence divergence_;
  float best_ = std::numeric_limits<float>::infinity();  // score
  Phase best_phase_;                                     // that it is of
};

}  // namespace lcdm::model
