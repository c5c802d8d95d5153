// Where each layer's output lives in the arena, and the table `lcdm inspect model` prints.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "firmware/nn/memory_plan.h"
#include "firmware/nn/network.h"

namespace lcdm {

struct NetworkPlan {
  std::vector<Lifetime> lifetimes;  // per layer; steps are layer indices
  MemoryPlan memory;                // per layer
};

// The sampler's start is a constant and takes no place. `keep_tensors`: nothing is reused, so that
// every output can be read after a run. `gap`: as plan_memory's.
NetworkPlan plan_network(const Network& network, bool keep_tensors, std::size_t gap = 0);

struct PlanRow {
  std::string name;
  const char* kind = "";
  Shape shape;
  std::int64_t macs = 0;
  std::size_t offset = 0;  // bytes from the arena's begin
  std::size_t bytes = 0;
  int first = 0;  // layer that writes it
  int last = 0;   // last layer that reads it
};

std::vector<PlanRow> plan_rows(const Network& network);

}  // namespace lcdm
