#include "model/replicas.h"

namespace lcdm::model {
namespace {

TrainedNetworks replica_of(const TrainedNetworks& original) {
  TrainedNetworks replica(original->depth->config, !original->pose.is_empty(),
                          original->cameras.is_empty() ? 0 : original->cameras->cameras());
  replica->depth->mixed_precision = original->depth->mixed_precision;
  replica->to(original->depth->direct->weight.device());  // the statistics too
  const auto weights = original->named_parameters();
  for (auto& item : replica->named_parameters()) {
    item.value().set_data(weights[item.key()].detach());
  }
  return replica;
}

}  // namespace

Replicas::Replicas(const TrainedNetworks& original, int workers) {
  networks_.push_back(original);
  while (size() < workers) networks_.push_back(replica_of(original));
  broadcast_statistics();
}

void Replicas::broadcast_statistics() {
  const torch::NoGradGuard no_grad;
  const auto statistics = of(0)->named_buffers();
  for (int i = 1; i < size(); ++i) {
    of(i)->depth->config = of(0)->depth->config;
    for (auto& item : of(i)->named_buffers()) item.value().copy_(statistics[item.key()]);
  }
}

void Replicas::clear_gradients() {
  for (TrainedNetworks& networks : networks_) {
    for (torch::Tensor& weight : networks->parameters()) weight.mutable_grad() = torch::Tensor();
  }
}

void Replicas::reduce() {
  if (size() == 1) return;
  const torch::NoGradGuard no_grad;
  auto weights = of(0)->named_parameters();
  auto statistics = of(0)->named_buffers();
  for (int i = 1; i < size(); ++i) {
    for (const auto& item : of(i)->named_parameters()) {
      torch::Tensor& sum = weights[item.key()].mutable_grad();
      const torch::Tensor& grad = item.value().grad();
      if (!grad.defined()) continue;
      sum = sum.defined() ? sum.add_(grad) : grad;
    }
    for (const auto& item : of(i)->named_buffers()) statistics[item.key()].add_(item.value());
  }
  for (auto& item : statistics) {
    if (item.value().is_floating_point()) {
      item.value().div_(size());
    } else {
      item.value().floor_divide_(size());
    }
  }
}

Status all_reduce(TrainedNetworks& networks, Processes& processes, Losses& losses) {
  if (processes.size() == 1) return Status::ok();
  const torch::NoGradGuard no_grad;
  std::vector<torch::Tensor> own;  // what is summed: gradients, then statistics
  for (const torch::Tensor& weight : networks->parameters()) {
    if (weight.grad().defined()) own.push_back(weight.grad());
  }
  for (torch::Tensor& buffer : networks->buffers()) {
    if (buffer.is_floating_point()) own.push_back(buffer.div_(processes.size()));
  }
  std::vector<torch::Tensor> flat;
  flat.reserve(own.size() + 1);
  for (const torch::Tensor& tensor : own) flat.push_back(tensor.reshape({-1}).cpu());
  torch::Tensor numbers = torch::empty({static_cast<std::int64_t>(losses.terms.size()) + 1});
  numbers[0] = losses.total.item<float>();
  for (std::size_t i = 0; i < losses.terms.size(); ++i) {
    numbers[static_cast<std::int64_t>(i) + 1] = losses.terms[i];
  }
  flat.push_back(numbers);
  torch::Tensor all = torch::cat(flat);
  LCDM_RETURN_IF_ERROR(processes.sum(all));
  std::int64_t at = 0;
  for (torch::Tensor& tensor : own) {
    tensor.copy_(all.narrow(0, at, tensor.numel()).reshape(tensor.sizes()));
    at += tensor.numel();
  }
  losses.total = all[at].clone();
  for (double& term : losses.terms) term = all[++at].item<double>();
  return Status::ok();
}

}  // namespace lcdm::model
