// The network lowered to kernel calls: weights packed, every pointer fixed, ready to run blindly.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/nn/arena.h"
#include "firmware/nn/constant_store.h"
#include "firmware/nn/model_file.h"
#include "firmware/nn/network.h"
#include "firmware/nn/network_plan.h"
#include "firmware/nn/worker_pool.h"

namespace lcdm {

// One kernel call, split among workers. Borrowed pointers into the program's memory.
class Step {
 public:
  virtual ~Step() = default;
  // Does part `worker` of `workers`, using `scratch` of at least scratch_floats().
  virtual void run(int worker, int workers, float* scratch) const noexcept = 0;
  virtual std::size_t scratch_floats() const { return 0; }
};

struct LoweringOptions {
  float depth_scale = 1;  // metres per canonical metre: fx of the network's input / f_c
  Precision precision = Precision::kFloat32;
};

class Program {
 public:
  struct Options {
    int workers = 1;
    bool keep_tensors = false;
    LoweringOptions lowering;
  };

  // The model must have passed network.check_weights(); it may be dropped afterwards.
  // kInvalidInput: it would take more memory than a board has to give; kOutOfMemory.
  static Result<Program> build(const Network& network, const ModelFile& model,
                               const Options& options);

  // From the input tensor to the depth tensor. `pool` has the number of workers given above.
  void run(WorkerPool& pool) const noexcept;
  // The same; adds each layer's nanoseconds to layer_ns, one value for each layer of the network.
  void run_timed(WorkerPool& pool, std::span<std::int64_t> layer_ns) const noexcept;

  // The output of layer `index`; between runs only if it is input or depth, or tensors are kept.
  std::span<float> tensor(int index) const { return tensors_[static_cast<std::size_t>(index)]; }
  std::span<float> input() const { return tensors_.front(); }
  std::span<float> depth() const { return tensors_.back(); }

  std::size_t arena_bytes() const { return arena_.bytes() + scratch_.bytes(); }
  std::size_t scratch_bytes() const { return scratch_.bytes(); }  // of all workers
  std::size_t constant_bytes() const { return constants_.bytes(); }
  // No activation, scratch or weight can be swapped out.
  bool memory_locked() const { return arena_.locked() && scratch_.locked() && constants_.locked(); }

 private:
  Program() = default;
  Status check_memory(const Network& network, const Options& options) const;
  Status place_tensors(const Network& network);
  Status lower(const Network& network, const ModelFile& model, const Options& options);
  Status make_scratch(int workers);
  void run_step(std::size_t index, WorkerPool& pool) const noexcept;
  void allow_tensors(int layer, int other_layer) const noexcept;
  void allow_scratch(std::size_t floats, int workers) const noexcept;
  void allow_results() const noexcept;

  NetworkPlan plan_;  // of arena_
  Arena arena_;       // activations
  Arena scratch_;     // scratch_pitch_ bytes per worker
  ConstantStore constants_;
  std::size_t scratch_pitch_ = 0;
  std::vector<std::span<float>> tensors_;  // per layer
  std::vector<std::unique_ptr<Step>> steps_;
  std::vector<int> layer_of_step_;
};

// Appends to `steps` what computes layer `index` (nothing for input, start and what its reader
// computes); packs its weights into `constants`. `tensors` holds every layer's output.
Status lower_layer(const Network& network, int index, const ModelFile& model,
                   const std::vector<std::span<float>>& tensors, const LoweringOptions& options,
                   ConstantStore& constants, std::vector<std::unique_ptr<Step>>& steps);

}  // namespace lcdm
