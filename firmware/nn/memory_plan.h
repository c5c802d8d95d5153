// From lifetimes to offsets: which tensors may share memory, decided once.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

namespace lcdm {

// A block that must keep its bytes from step `first` to step `last`, both included.
struct Lifetime {
  std::size_t bytes = 0;
  int first = 0;
  int last = 0;
};

struct MemoryPlan {
  static constexpr std::size_t kAlignment = 64;  // bytes: a cache line, the widest vector

  // The next multiple of it.
  static constexpr std::size_t aligned(std::size_t bytes) {
    return (bytes + kAlignment - 1) / kAlignment * kAlignment;
  }

  std::vector<std::size_t> offsets;  // one per lifetime, multiples of kAlignment
  std::size_t bytes = 0;             // of the whole, a multiple of kAlignment
};

// First fit by falling size: each block goes to the lowest offset where no block already placed
// lives at the same time. `gap` bytes behind each belong to no block that does. Depends on its
// arguments alone.
MemoryPlan plan_memory(std::span<const Lifetime> lifetimes, std::size_t gap = 0);

}  // namespace lcdm
