#include "firmware/nn/constant_store.h"

#include <algorithm>
#include <numeric>

#include "firmware/base/os.h"
#include "firmware/nn/memory_plan.h"

namespace lcdm {
namespace {

std::size_t room_of(std::size_t count) {
  return MemoryPlan::aligned(count * sizeof(float)) + os::kGuardBytes;
}

}  // namespace

std::span<float> ConstantStore::Block::take(std::size_t count) {
  const std::span<float> piece = memory.floats(used, count);
  memory.allow(used, piece.size_bytes());
  used += room_of(count);
  return piece;
}

Result<std::span<float>> ConstantStore::add(std::size_t count) {
  const std::size_t bytes = room_of(count);
  for (Block& block : blocks_) {
    if (block.memory.bytes() - block.used >= bytes) return block.take(count);
  }
  const std::size_t pages =
      std::max<std::size_t>(1, (bytes + os::kHugePageBytes - 1) / os::kHugePageBytes);
  Result<Arena> memory = Arena::allocate(pages * os::kHugePageBytes);
  if (!memory) return memory.status();
  memory->forbid();
  blocks_.push_back({std::move(*memory), 0});
  return blocks_.back().take(count);
}

std::size_t ConstantStore::bytes() const {
  return std::accumulate(
      blocks_.begin(), blocks_.end(), std::size_t{0},
      [](std::size_t sum, const Block& block) { return sum + block.memory.bytes(); });
}

bool ConstantStore::locked() const {
  return std::all_of(blocks_.begin(), blocks_.end(),
                     [](const Block& b) { return b.memory.locked(); });
}

}  // namespace lcdm
