#include "firmware/nn/memory_plan.h"

#include <algorithm>
#include <numeric>

namespace lcdm {
namespace {

bool live_together(const Lifetime& a, const Lifetime& b) {
  return a.first <= b.last && b.first <= a.last;
}

struct Range {
  std::size_t begin;
  std::size_t end;
};

// The lowest offset at which `bytes` fit between `taken`, which is sorted by begin.
std::size_t first_gap(const std::vector<Range>& taken, std::size_t bytes) {
  std::size_t offset = 0;
  for (const Range& range : taken) {
    if (offset + bytes <= range.begin) break;
    offset = std::max(offset, range.end);
  }
  return offset;
}

}  // namespace

MemoryPlan plan_memory(std::span<const Lifetime> lifetimes, std::size_t gap) {
  const auto room_of = [gap](const Lifetime& block) {
    return block.bytes > 0 ? MemoryPlan::aligned(block.bytes + gap) : 0;
  };
  std::vector<std::size_t> order(lifetimes.size());
  std::iota(order.begin(), order.end(), 0U);
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return lifetimes[a].bytes > lifetimes[b].bytes;
  });

  MemoryPlan plan;
  plan.offsets.resize(lifetimes.size());
  std::vector<std::size_t> placed;
  for (const std::size_t block : order) {
    std::vector<Range> taken;
    for (const std::size_t other : placed) {
      if (!live_together(lifetimes[block], lifetimes[other])) continue;
      const std::size_t begin = plan.offsets[other];
      taken.push_back({begin, begin + room_of(lifetimes[other])});
    }
    std::sort(taken.begin(), taken.end(),
              [](const Range& a, const Range& b) { return a.begin < b.begin; });
    const std::size_t bytes = room_of(lifetimes[block]);
    plan.offsets[block] = first_gap(taken, bytes);
    plan.bytes = std::max(plan.bytes, plan.offsets[block] + bytes);
    placed.push_back(block);
  }
  return plan;
}

}  // namespace lcdm
