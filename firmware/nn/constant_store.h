// Packed weights and tables, made at prepare and read for as long as the program lives.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/nn/arena.h"

namespace lcdm {

// Memory that lives as long as the program: packed weights and constants. Hands out pieces of
// large blocks; never gives one back before its own end.
class ConstantStore {
 public:
  // Zeroed and aligned to MemoryPlan::kAlignment.
  Result<std::span<float>> add(std::size_t count);
  std::size_t bytes() const { return bytes_; }  // handed out
  bool locked() const;                          // all of it

 private:
  std::vector<Arena> blocks_;
  std::size_t used_ = 0;  // bytes of the last block
  std::size_t bytes_ = 0;
};

}  // namespace lcdm
