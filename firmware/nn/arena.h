// One block of memory for everything a frame needs, made before the first frame.
#pragma once

#include <cstddef>
#include <span>

#include "firmware/base/os.h"
#include "firmware/base/status.h"

namespace lcdm {

// Page-aligned, zeroed, every page touched, and locked against swapping where the process may;
// moved, never copied. Owned by one Engine.
class Arena {
 public:
  Arena() = default;
  static Result<Arena> allocate(std::size_t bytes);
  ~Arena();
  Arena(Arena&& other) noexcept;
  Arena& operator=(Arena&& other) noexcept;
  Arena(const Arena&) = delete;
  Arena& operator=(const Arena&) = delete;

  std::size_t bytes() const { return bytes_; }
  bool locked() const { return locked_; }
  // `count` floats from byte `offset`, which is a multiple of 4; within the block, checked.
  std::span<float> floats(std::size_t offset, std::size_t count) const;

  // With AddressSanitizer nothing of it may be touched any more, and then only what is allowed
  // again (os::kGuardBytes).
  void forbid() const { os::forbid_memory(memory_, bytes_); }
  void allow(std::size_t offset, std::size_t bytes) const {
    os::allow_memory(memory_ + offset, bytes);
  }

 private:
  std::byte* memory_ = nullptr;
  std::size_t bytes_ = 0;
  bool locked_ = false;
};

}  // namespace lcdm
