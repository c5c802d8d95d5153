#include "model/divergence.h"

#include <algorithm>
#include <cstdio>
#include <numeric>
#include <vector>

namespace lcdm::model {
namespace {

// A step counts as this many least means at most: one wild batch, whose gradient is clipped, is no
// divergence.
constexpr float kMostOfOne = 100;

}  // namespace

void Divergence::add(double loss, Phase phase) {
  if (phase != phase_) *this = {};
  phase_ = phase;
  recent_.push_back(std::min(static_cast<float>(loss), kMostOfOne * least_));
  if (recent_.size() > kWindow) recent_.pop_front();
  if (recent_.size() < kWindow) return;
  mean_ = static_cast<float>(std::accumulate(recent_.begin(), recent_.end(), 0.0) / kWindow);
  least_ = std::min(least_, mean_);
}

bool Divergence::found() const { return mean_ > kWorst * least_; }

std::string Divergence::text() const {
  char text[120];
  std::snprintf(text, sizeof(text), "the mean loss of the last %zu steps is %.3g, it was %.3g",
                kWindow, mean_, least_);
  return text;
}

torch::Tensor Divergence::numbers() const {
  std::vector<float> all = {phase_.number(), mean_, least_};
  all.insert(all.end(), recent_.begin(), recent_.end());
  return torch::tensor(all);
}

void Divergence::restore(const torch::Tensor& numbers) {
  phase_ = Phase::from_number(numbers[0].item<float>());
  mean_ = numbers[1].item<float>();
  least_ = numbers[2].item<float>();
  const torch::Tensor recent = numbers.slice(0, 3).contiguous();
  recent_.assign(recent.data_ptr<float>(), recent.data_ptr<float>() + recent.numel());
}

}  // namespace lcdm::model
