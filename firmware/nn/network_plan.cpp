#include "firmware/nn/network_plan.h"

#include <algorithm>

namespace lcdm {

namespace {

// When each layer is computed: where it stands, or inside its reader.
std::vector<int> moments_of(const Network& network) {
  std::vector<int> moments(network.layers().size());
  for (int i = static_cast<int>(moments.size()) - 1; i >= 0; --i) {
    const Layer& layer = network.layer(i);
    int& moment = moments[static_cast<std::size_t>(i)];
    if (layer.stored) moment = i;
    for (const Source& source : layer.inputs) {
      if (!network.layer(source.layer).stored) {
        moments[static_cast<std::size_t>(source.layer)] = moment;
      }
    }
  }
  return moments;
}

// Of a layer's output and, behind it, of what its kernels keep from one phase to the next: group
// norm's moments of each row.
std::size_t bytes_of(const Layer& layer) {
  const Shape& out = layer.output;
  const bool has_moments = layer.kind == LayerKind::kGroupNorm;
  const int moments = has_moments ? 2 * out.height * out.channels : 0;
  return (out.count() + static_cast<std::size_t>(moments)) * sizeof(float);
}

}  // namespace

NetworkPlan plan_network(const Network& network, bool keep_tensors, std::size_t gap) {
  const std::vector<Layer>& layers = network.layers();
  const int end = static_cast<int>(layers.size()) - 1;
  const std::vector<int> moments = moments_of(network);
  NetworkPlan plan;
  for (int i = 0; i <= end; ++i) {
    const Layer& layer = network.layer(i);
    const bool in_arena = layer.kind != LayerKind::kStart && (layer.stored || keep_tensors);
    const std::size_t bytes = in_arena ? bytes_of(layer) : 0;
    plan.lifetimes.push_back({bytes, keep_tensors ? 0 : i, keep_tensors ? end : i});
    const auto used_here = [&](int input) {
      int& last = plan.lifetimes[static_cast<std::size_t>(input)].last;
      last = std::max(last, moments[static_cast<std::size_t>(i)]);
    };
    for (const Source& source : layer.inputs) used_here(source.layer);
    if (layer.residual >= 0) used_here(layer.residual);
  }
  plan.memory = plan_memory(plan.lifetimes, gap);
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
