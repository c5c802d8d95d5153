#include "firmware/nn/program.h"

#include <algorithm>
#include <utility>

#include "firmware/base/os.h"
#include "firmware/nn/noise.h"

namespace lcdm {
namespace {

// Far more than ours take at any size, and what a board can do without.
constexpr std::size_t kMostBytes = 512U << 20;

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

bool lives_at(const Lifetime& life, int layer) { return life.first <= layer && layer <= life.last; }

}  // namespace

Result<Program> Program::build(const Network& network, const ModelFile& model,
                               const Options& options) {
  Program program;
  program.plan_ = plan_network(network, options.keep_tensors, os::kGuardBytes);
  LCDM_RETURN_IF_ERROR(program.check_memory(network, options));
  LCDM_RETURN_IF_ERROR(program.place_tensors(network));
  LCDM_RETURN_IF_ERROR(program.lower(network, model, options));
  LCDM_RETURN_IF_ERROR(program.make_scratch(options.workers));
  program.allow_results();
  return program;
}

// Of all that is known to be needed so far, whether it is there already or not.
Status Program::check_memory(const Network& network, const Options& options) const {
  const std::size_t layers = plan_.memory.bytes;
  const std::size_t weights = constants_.bytes();
  const std::size_t scratch = scratch_pitch_ * static_cast<std::size_t>(options.workers);
  const std::size_t bytes = layers + weights + scratch;
  if (bytes <= kMostBytes || options.keep_tensors) return Status::ok();
  return Status::error(StatusCode::kInvalidInput,
                       "this model needs %zu MB or more at %dx%d (layers %zu, weights %zu, scratch "
                       "%zu), at most %zu are given: choose a smaller model.width and "
                       "model.height, fewer model.threads, or another model",
                       bytes >> 20, network.width(), network.height(), layers >> 20, weights >> 20,
                       scratch >> 20, kMostBytes >> 20);
}

Status Program::place_tensors(const Network& network) {
  Result<Arena> arena = Arena::allocate(plan_.memory.bytes);
  if (!arena) return arena.status();
  arena_ = std::move(*arena);
  for (std::size_t i = 0; i < network.layers().size(); ++i) {
    const Layer& layer = network.layers()[i];
    if (layer.kind == LayerKind::kStart) {
      const Result<std::span<float>> start = make_start(network, constants_);
      if (!start) return start.status();
      tensors_.push_back(*start);
    } else if (plan_.lifetimes[i].bytes == 0) {
      tensors_.emplace_back();
    } else {
      tensors_.push_back(arena_.floats(plan_.memory.offsets[i], layer.output.count()));
    }
  }
  return Status::ok();
}

Status Program::lower(const Network& network, const ModelFile& model, const Options& options) {
  for (std::size_t i = 0; i < network.layers().size(); ++i) {
    LCDM_RETURN_IF_ERROR(lower_layer(network, static_cast<int>(i), model, tensors_,
                                     options.lowering, constants_, steps_));
    for (std::size_t step = layer_of_step_.size(); step < steps_.size(); ++step) {
      const std::size_t bytes = steps_[step]->scratch_floats() * sizeof(float);
      scratch_pitch_ = std::max(scratch_pitch_, MemoryPlan::aligned(bytes) + os::kGuardBytes);
    }
    layer_of_step_.resize(steps_.size(), static_cast<int>(i));
    LCDM_RETURN_IF_ERROR(check_memory(network, options));
  }
  return Status::ok();
}

Status Program::make_scratch(int workers) {
  Result<Arena> scratch = Arena::allocate(scratch_pitch_ * static_cast<std::size_t>(workers));
  if (!scratch) return scratch.status();
  scratch_ = std::move(*scratch);
  return Status::ok();
}

// With AddressSanitizer a step can touch, of the activations, those that live then, and as much
// scratch as it asked for; between runs input and depth can be, and what is kept.
void Program::allow_tensors(int layer, int other_layer) const noexcept {
  if (os::kGuardBytes == 0) return;
  arena_.forbid();
  for (std::size_t i = 0; i < plan_.lifetimes.size(); ++i) {
    const Lifetime& life = plan_.lifetimes[i];
    if (!lives_at(life, layer) && !lives_at(life, other_layer)) continue;
    arena_.allow(plan_.memory.offsets[i], life.bytes);
  }
}

void Program::allow_scratch(std::size_t floats, int workers) const noexcept {
  if (os::kGuardBytes == 0) return;
  scratch_.forbid();
  for (std::size_t worker = 0; worker < static_cast<std::size_t>(workers); ++worker) {
    scratch_.allow(worker * scratch_pitch_, floats * sizeof(float));
  }
}

void Program::allow_results() const noexcept {
  allow_tensors(0, static_cast<int>(tensors_.size()) - 1);
}

void Program::run_step(std::size_t index, WorkerPool& pool) const noexcept {
  const Step& step = *steps_[index];
  allow_tensors(layer_of_step_[index], layer_of_step_[index]);
  allow_scratch(step.scratch_floats(), pool.workers());
  pool.run([&](int worker) {
    const std::size_t offset = static_cast<std::size_t>(worker) * scratch_pitch_;
    step.run(worker, pool.workers(), scratch_.floats(offset, step.scratch_floats()).data());
  });
}

void Program::run(WorkerPool& pool) const noexcept {
  for (std::size_t i = 0; i < steps_.size(); ++i) run_step(i, pool);
  allow_results();
}

void Program::run_timed(WorkerPool& pool, std::span<std::int64_t> layer_ns) const noexcept {
  std::int64_t before = os::monotonic_ns();
  for (std::size_t i = 0; i < steps_.size(); ++i) {
    run_step(i, pool);
    const std::int64_t after = os::monotonic_ns();
    layer_ns[static_cast<std::size_t>(layer_of_step_[i])] += after - before;
    before = after;
  }
  allow_results();
}

}  // namespace lcdm
