#include "model/optimizer.h"

#include <atomic>
#include <cmath>
#include <future>
#include <tuple>
#include <utility>

#include "model/muon.h"
#include "model/worker_thread.h"

namespace lcdm::model {
namespace {

constexpr double kBeta1 = 0.9;
constexpr double kBeta2 = 0.999;
constexpr double kEpsilon = 1e-8;

}  // namespace

Optimizer::Optimizer(OptimizerKind kind, const torch::nn::Module& module, double weight_decay,
                     int threads)
    : weight_decay_(weight_decay), threads_(threads) {
  for (const auto& item : module.named_parameters()) {
    const torch::Tensor& parameter = item.value();
    const bool muon = kind == OptimizerKind::kMuon && item.key().starts_with("depth.") &&
                      item.key().ends_with(".weight") && is_matrix(parameter);
    const torch::Tensor square = muon ? torch::Tensor() : torch::zeros_like(parameter);
    slots_.push_back({item.key(), parameter, torch::zeros_like(parameter), square});
  }
}

double Optimizer::clip(double limit) {
  std::vector<torch::Tensor> gradients;
  for (const Slot& slot : slots_) {
    if (slot.parameter.grad().defined()) gradients.push_back(slot.parameter.grad());
  }
  if (gradients.empty()) return 0;
  const double norm = torch::stack(at::_foreach_norm(gradients)).norm().item<double>();
  if (norm > limit) at::_foreach_mul_(gradients, limit / norm);
  return norm;
}

std::vector<Optimizer::Group> Optimizer::groups(
    const std::function<double(const std::string&)>& rate_of) {
  constexpr std::size_t kMost = 16;  // slots: threads are to find enough groups
  // By shape as a matrix (none for AdamW), rate and steps.
  std::map<std::tuple<std::int64_t, std::int64_t, double, std::int64_t>, Group> open;
  std::vector<Group> all;
  for (Slot& slot : slots_) {
    const torch::Tensor& parameter = slot.parameter;
    if (!parameter.grad().defined()) continue;
    const double rate = rate_of(slot.name);
    const std::int64_t rows = slot.muon() ? parameter.size(0) : 0;
    const std::int64_t columns = slot.muon() ? parameter.numel() / rows : 0;
    Group& group = open[{rows, columns, rate, slot.steps}];
    group.muon = slot.muon();
    group.rate = rate;
    group.steps = slot.steps;
    group.slots.push_back(&slot);
    if (group.slots.size() == kMost) all.push_back(std::exchange(group, {}));
  }
  for (auto& [key, group] : open) {
    if (!group.slots.empty()) all.push_back(std::move(group));
  }
  return all;
}

void Optimizer::step(const std::function<double(const std::string&)>& rate_of) {
  const std::vector<Group> all = groups(rate_of);
  std::atomic<std::size_t> next = 0;
  const auto work = [&] {
    const torch::NoGradGuard no_grad;
    begin_worker_thread();
    for (std::size_t i = next++; i < all.size(); i = next++) change(all[i]);
  };
  std::vector<std::future<void>> running;
  for (int i = 0; i < threads_; ++i) running.push_back(std::async(std::launch::async, work));
  for (std::future<void>& each : running) each.get();
}

void Optimizer::change(const Group& group) const {
  std::vector<torch::Tensor> parameters, decayed, gradients, means, squares;
  for (Slot* slot : group.slots) {
    ++slot->steps;
    parameters.push_back(slot->parameter);
    if (slot->parameter.dim() > 1) decayed.push_back(slot->parameter);
    gradients.push_back(slot->parameter.grad());
    means.push_back(slot->mean);
    squares.push_back(slot->square);
  }
  if (!decayed.empty()) at::_foreach_mul_(decayed, 1 - group.rate * weight_decay_);
  if (group.muon) {
    at::_foreach_add_(parameters, muon_updates(gradients, means), group.rate);
    return;
  }
  const auto steps = static_cast<double>(group.steps + 1);
  at::_foreach_mul_(means, kBeta1);
  at::_foreach_add_(means, gradients, 1 - kBeta1);
  at::_foreach_mul_(squares, kBeta2);
  at::_foreach_addcmul_(squares, gradients, gradients, 1 - kBeta2);
  const std::vector<torch::Tensor> scales = at::_foreach_sqrt(squares);
  at::_foreach_div_(scales, std::sqrt(1 - std::pow(kBeta2, steps)));
  at::_foreach_add_(scales, kEpsilon);
  at::_foreach_addcdiv_(parameters, means, scales, -group.rate / (1 - std::pow(kBeta1, steps)));
}

void Optimizer::save(std::map<std::string, torch::Tensor>& tensors) const {
  for (const Slot& slot : slots_) {
    if (!slot.muon()) {
      tensors["adam.mean." + slot.name] = slot.mean;
      tensors["adam.square." + slot.name] = slot.square;
    } else {
      tensors["muon.momentum." + slot.name] = slot.mean;
    }
    tensors["adam.steps." + slot.name] = torch::tensor({slot.steps}, torch::kLong);
  }
}

bool Optimizer::load(const std::map<std::string, torch::Tensor>& tensors) {
  const auto copy = [&tensors](const std::string& name, torch::Tensor& to) {
    const auto found = tensors.find(name);
    if (found == tensors.end() || found->second.sizes() != to.sizes()) return false;
    to.copy_(found->second);
    return true;
  };
  for (Slot& slot : slots_) {
    torch::Tensor steps = torch::zeros({1}, torch::kLong);
    const bool moments = slot.muon() ? copy("muon.momentum." + slot.name, slot.mean)
                                     : copy("adam.mean." + slot.name, slot.mean) &&
                                           copy("adam.square." + slot.name, slot.square);
    if (!moments || !copy("adam.steps." + slot.name, steps)) return false;
    slot.steps = steps.item<std::int64_t>();
  }
  return true;
}

}  // namespace lcdm::model
