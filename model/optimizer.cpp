#include "model/optimizer.h"

#include <atomic>
#include <cmath>
#include <future>

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
  double square = 0;
  for (const Slot& slot : slots_) {
    if (slot.parameter.grad().defined()) {
      square += std::pow(slot.parameter.grad().norm().item<double>(), 2);
    }
  }
  const double norm = std::sqrt(square);
  if (norm > limit) {
    for (Slot& slot : slots_) {
      if (slot.parameter.grad().defined()) slot.parameter.mutable_grad().mul_(limit / norm);
    }
  }
  return norm;
}

void Optimizer::step(const std::function<double(const std::string&)>& rate_of) {
  std::atomic<std::size_t> next = 0;
  const auto work = [&] {
    const torch::NoGradGuard no_grad;
    begin_worker_thread();
    for (std::size_t i = next++; i < slots_.size(); i = next++) {
      if (slots_[i].parameter.grad().defined()) change(slots_[i], rate_of(slots_[i].name));
    }
  };
  std::vector<std::future<void>> running;
  for (int i = 0; i < threads_; ++i) running.push_back(std::async(std::launch::async, work));
  for (std::future<void>& each : running) each.get();
}

void Optimizer::change(Slot& slot, double rate) const {
  const torch::Tensor gradient = slot.parameter.grad();
  const auto steps = static_cast<double>(++slot.steps);
  if (slot.parameter.dim() > 1) slot.parameter.mul_(1 - rate * weight_decay_);
  if (!slot.square.defined()) {
    slot.parameter.add_(muon_update(gradient, slot.mean), rate);
    return;
  }
  slot.mean.mul_(kBeta1).add_(gradient, 1 - kBeta1);
  slot.square.mul_(kBeta2).addcmul_(gradient, gradient, 1 - kBeta2);
  const torch::Tensor scale =
      slot.square.sqrt().div_(std::sqrt(1 - std::pow(kBeta2, steps))).add_(kEpsilon);
  slot.parameter.addcdiv_(slot.mean, scale, -rate / (1 - std::pow(kBeta1, steps)));
}

void Optimizer::save(std::map<std::string, torch::Tensor>& tensors) const {
  for (const Slot& slot : slots_) {
    if (slot.square.defined()) {
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
    const bool moments = slot.square.defined() ? copy("adam.mean." + slot.name, slot.mean) &&
                                                     copy("adam.square." + slot.name, slot.square)
                                               : copy("muon.momentum." + slot.name, slot.mean);
    if (!moments || !copy("adam.steps." + slot.name, steps)) return false;
    slot.steps = steps.item<std::int64_t>();
  }
  return true;
}

}  // namespace lcdm::model
