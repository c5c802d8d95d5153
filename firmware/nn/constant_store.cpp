#include "firmware/nn/constant_store.h"

#include <algorithm>

#include "firmware/nn/memory_plan.h"

namespace lcdm {

Result<std::span<float>> ConstantStore::add(std::size_t count) {
  constexpr std::size_t kBlockBytes = 1U << 20;
  const std::size_t bytes = MemoryPlan::aligned(count * sizeof(float));
  if (blocks_.empty() || blocks_.back().bytes() - used_ < bytes) {
    Result<Arena> block = Arena::allocate(std::max(bytes, kBlockBytes));
    if (!block) return block.status();
    blocks_.push_back(std::move(*block));
    used_ = 0;
  }
  const std::span<float> piece = blocks_.back().floats(used_, count);
  used_ += bytes;
  bytes_ += bytes;
  return piece;
}

bool ConstantStore::locked() const {
  return std::all_of(blocks_.begin(), blocks_.end(), [](const Arena& b) { return b.locked(); });
}

}  // namespace lcdm
