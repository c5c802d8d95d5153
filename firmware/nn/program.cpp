#include "firmware/nn/program.h"

#include <algorithm>

#include "firmware/base/os.h"
#include "firmware/nn/noise.h"

namespace lcdm {
namespace {

// Far more than ours take at any size, and what a board can do without.
constexpr std::size_t kMostArenaBytes = 512U << 20;

// The sampler's start, as a constant.
Result<std::span<float>> make_start(const Network& network, ConstantStore& constants) {
  const std::size_t count =
      static_cast<std::size_t>(network.width()) * static_cast<std::size_t>(network.height());
  Result<std::span<float>> start = constants.add(count);
  if (start && network.config().start == StartKind::kNoise) {
    fill_gaussian(network.config().seed, *start);
  }
  return start;
}

}  // namespace

Result<Program> Program::build(const Network& network, const ModelFile& model,
                               const Options& options) {
  const NetworkPlan plan = plan_network(network, options.keep_tensors);
  if (plan.memory.bytes > kMostArenaBytes && !options.keep_tensors) {
    return Status::error(
        StatusCode::kInvalidInput,
        "this model's layers need %zu MB at %dx%d, at most %zu are given: choose a "
        "smaller model.width and model.height, or another model",
        plan.memory.bytes >> 20, network.width(), network.height(), kMostArenaBytes >> 20);
  }
  Program program;
  Result<Arena> arena = Arena::allocate(plan.memory.bytes);
  if (!arena) return arena.status();
  program.arena_ = std::move(*arena);

  for (std::size_t i = 0; i < network.layers().size(); ++i) {
    const Layer& layer = network.layers()[i];
    if (layer.kind == LayerKind::kStart) {
      const Result<std::span<float>> start = make_start(network, program.constants_);
      if (!start) return start.status();
      program.tensors_.push_back(*start);
    } else if (plan.lifetimes[i].bytes == 0) {
      program.tensors_.emplace_back();
    } else {
      program.tensors_.push_back(
          program.arena_.floats(plan.memory.offsets[i], layer.output.count()));
    }
  }
  for (std::size_t i = 0; i < network.layers().size(); ++i) {
    LCDM_RETURN_IF_ERROR(lower_layer(network, static_cast<int>(i), model, program.tensors_,
                                     options.lowering, program.constants_, program.steps_));
    program.layer_of_step_.resize(program.steps_.size(), i);
  }

  std::size_t scratch_bytes = 0;
  for (const auto& step : program.steps_) {
    scratch_bytes =
        std::max(scratch_bytes, MemoryPlan::aligned(step->scratch_floats() * sizeof(float)));
  }
  Result<Arena> scratch =
      Arena::allocate(scratch_bytes * static_cast<std::size_t>(options.workers));
  if (!scratch) return scratch.status();
  program.scratch_ = std::move(*scratch);
  program.scratch_floats_ = scratch_bytes / sizeof(float);
  return program;
}

void Program::run_step(const Step& step, WorkerPool& pool) const noexcept {
  pool.run([&](int worker) {
    const std::size_t offset = static_cast<std::size_t>(worker) * scratch_floats_;
    float* scratch = scratch_.floats(offset * sizeof(float), scratch_floats_).data();
    step.run(worker, pool.workers(), scratch);
  });
}

void Program::run(WorkerPool& pool) const noexcept {
  for (const auto& step : steps_) run_step(*step, pool);
}

void Program::run_timed(WorkerPool& pool, std::span<std::int64_t> layer_ns) const noexcept {
  std::int64_t before = os::monotonic_ns();
  for (std::size_t i = 0; i < steps_.size(); ++i) {
    run_step(*steps_[i], pool);
    const std::int64_t after = os::monotonic_ns();
    layer_ns[layer_of_step_[i]] += after - before;
    before = after;
  }
}

}  // namespace lcdm
