#include "firmware/nn/network_plan.h"

#include <algorithm>

namespace lcdm {

NetworkPlan plan_network(const Network& network, bool keep_tensors) {
  const std::vector<Layer>& layers = network.layers();
  const int end = static_cast<int>(layers.size()) - 1;
  NetworkPlan plan;
  for (int i = 0; i <= end; ++i) {
    const Layer& layer = network.layer(i);
    const bool constant = layer.kind == LayerKind::kStart;
    const std::size_t bytes = constant ? 0 : layer.output.count() * sizeof(float);
    plan.lifetimes.push_back({bytes, keep_tensors ? 0 : i, keep_tensors ? end : i});
    const auto used_here = [&](int input) {
      int& last = plan.lifetimes[static_cast<std::size_t>(input)].last;
      last = std::max(last, i);
    };
    for (const Source& source : layer.inputs) used_here(source.layer);
    if (layer.residual >= 0) used_here(layer.residual);
  }
  plan.memory = plan_memory(plan.lifetimes);
  return plan;
}

std::vector<PlanRow> plan_rows(const Network& network) {
  const NetworkPlan plan = plan_network(network, false);
  std::vector<PlanRow> rows;
  for (std::size_t i = 0; i < network.layers().size(); ++i) {
    const Layer& layer = network.layers()[i];
    const Lifetime& life = plan.lifetimes[i];
    rows.push_back({layer.name, to_string(layer.kind), layer.output, layer.macs,
                    plan.memory.offsets[i], life.bytes, life.first, life.last});
  }
  return rows;
}

}  // namespace lcdm
