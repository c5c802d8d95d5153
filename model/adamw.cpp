#include "model/adamw.h"

#include <cmath>

namespace lcdm::model {
namespace {

constexpr double kBeta1 = 0.9;
constexpr double kBeta2 = 0.999;
constexpr double kEpsilon = 1e-8;

}  // namespace

AdamW::AdamW(const torch::nn::Module& module, double weight_decay) : weight_decay_(weight_decay) {
  for (const auto& item : module.named_parameters()) {
    slots_.push_back({item.key(), item.value(), torch::zeros_like(item.value()),
                      torch::zeros_like(item.value())});
  }
}

double AdamW::clip(double limit) {
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

void AdamW::step(const std::function<double(const std::string&)>& rate_of) {
  const torch::NoGradGuard no_grad;
  for (Slot& slot : slots_) {
    const torch::Tensor gradient = slot.parameter.grad();
    if (!gradient.defined()) continue;
    const double rate = rate_of(slot.name);
    const auto steps = static_cast<double>(++slot.steps);
    if (slot.parameter.dim() > 1) slot.parameter.mul_(1 - rate * weight_decay_);
    slot.mean.mul_(kBeta1).add_(gradient, 1 - kBeta1);
    slot.square.mul_(kBeta2).addcmul_(gradient, gradient, 1 - kBeta2);
    const torch::Tensor scale =
        slot.square.sqrt().div_(std::sqrt(1 - std::pow(kBeta2, steps))).add_(kEpsilon);
    slot.parameter.addcdiv_(slot.mean, scale, -rate / (1 - std::pow(kBeta1, steps)));
  }
}

void AdamW::save(std::map<std::string, torch::Tensor>& tensors) const {
  for (const Slot& slot : slots_) {
    tensors["adam.mean." + slot.name] = slot.mean;
    tensors["adam.square." + slot.name] = slot.square;
    tensors["adam.steps." + slot.name] = torch::tensor({slot.steps}, torch::kLong);
  }
}

bool AdamW::load(const std::map<std::string, torch::Tensor>& tensors) {
  const auto copy = [&tensors](const std::string& name, torch::Tensor& to) {
    const auto found = tensors.find(name);
    if (found == tensors.end() || found->second.sizes() != to.sizes()) return false;
    to.copy_(found->second);
    return true;
  };
  for (Slot& slot : slots_) {
    torch::Tensor steps = torch::zeros({1}, torch::kLong);
    if (!copy("adam.mean." + slot.name, slot.mean) ||
        !copy("adam.square." + slot.name, slot.square) || !copy("adam.steps." + slot.name, steps)) {
      return false;
    }
    slot.steps = steps.item<std::int64_t>();
  }
  return true;
}

}  // namespace lcdm::model
