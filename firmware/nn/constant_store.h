// Packed weights and tables, made at prepare and read for as long as the program lives.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/nn/arena.h"

namespace lcdm {

// Memory that lives as long as the program: packed weights and constants. Hands out pieces of
// blocks that are whole huge pages, from the first that has room; never gives one back before its
// own end.
class ConstantStore {
 public:
  // Zeroed and aligned to MemoryPlan::kAlignment.
  Result<std::span<float>> add(std::size_t count);
  std::size_t bytes() const;  // of the blocks, whatever of them is handed out
  bool locked() const;        // all of it

 private:
  struct Block {
    Arena memory;
    std::size_t used;  // bytes

    std::span<float> take(std::size_t count);
  };
  std::vector<Block> blocks_;
};

}  // namespace lcdm
