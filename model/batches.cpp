#include "model/batches.h"

#include <ATen/Parallel.h>
#include <algorithm>
#include <random>

namespace lcdm::model {
namespace {

constexpr std::size_t kAhead = 4;  // batches ready or in work

}  // namespace

BatchMaker::BatchMaker(std::vector<Source> sources, Options options)
    : sources_(std::move(sources)),
      options_(std::move(options)),
      next_to_make_(options_.first),
      next_to_give_(options_.first) {
  for (int i = 0; i < options_.workers; ++i) threads_.emplace_back([this] { work(); });
}

BatchMaker::~BatchMaker() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
  }
  changed_.notify_all();
  for (std::thread& thread : threads_) thread.join();
}

Batch BatchMaker::next() {
  std::unique_lock lock(mutex_);
  const auto wanted = [this] {
    return std::find_if(ready_.begin(), ready_.end(),
                        [this](const Slot& slot) { return slot.number == next_to_give_; });
  };
  changed_.wait(lock, [&] { return wanted() != ready_.end(); });
  const auto slot = wanted();
  Batch batch = std::move(slot->batch);
  ready_.erase(slot);
  ++next_to_give_;
  lock.unlock();
  changed_.notify_all();
  return batch;
}

void BatchMaker::work() {
  at::set_num_threads(1);  // of this thread: the training step has the processors
  std::unique_lock lock(mutex_);
  while (true) {
    changed_.wait(lock, [this] { return stopping_ || next_to_make_ < next_to_give_ + kAhead; });
    if (stopping_) return;
    const std::uint64_t number = next_to_make_++;
    lock.unlock();
    Batch batch = make(number);
    lock.lock();
    ready_.push_back({number, std::move(batch)});
    changed_.notify_all();
  }
}

Batch BatchMaker::make(std::uint64_t number) const {
  std::mt19937_64 random(options_.seed * 0x9E3779B97F4A7C15ULL + number);
  std::vector<double> weights;
  for (const Source& source : sources_) weights.push_back(source.weight);
  const Source& source =
      sources_[std::discrete_distribution<std::size_t>(weights.begin(), weights.end())(random)];
  const auto& shape = options_.shapes[number % options_.shapes.size()];

  std::vector<torch::Tensor> images, depths;
  for (int i = 0; i < options_.batch_size; ++i) {
    const Frame& frame = *source.frames[random() % source.frames.size()];
    Sample sample =
        make_sample(frame, shape[0], shape[1], options_.canonical_focal, options_.augment, random);
    images.push_back(std::move(sample.image));
    depths.push_back(std::move(sample.depth));
  }
  return {torch::stack(images), torch::stack(depths),
          std::vector<bool>(images.size(), source.reliable_scale)};
}

VariableStatistics measure_variable(BatchMaker& batches, int count) {
  std::vector<torch::Tensor> logits;
  for (int i = 0; i < count; ++i) {
    const torch::Tensor depth = batches.next().depth;
    const torch::Tensor known = depth.masked_select(depth.gt(0.1).logical_and(depth.lt(100)));
    logits.push_back(torch::logit(((1 / known - 0.01) / 9.99).clamp(1e-4, 1 - 1e-4)));
  }
  const torch::Tensor all = torch::cat(logits).to(torch::kDouble);
  return {all.mean().item<double>(), all.std().item<double>()};
}

}  // namespace lcdm::model
