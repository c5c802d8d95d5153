#include "firmware/nn/arena.h"

#include <utility>

namespace lcdm {

Result<Arena> Arena::allocate(std::size_t bytes) {
  const Result<std::byte*> memory = os::allocate_pages(bytes);
  if (!memory) return memory.status();
  Arena arena;
  arena.memory_ = *memory;
  arena.bytes_ = bytes;
  arena.locked_ = os::lock_pages(*memory, bytes).is_ok();
  return arena;
}

Arena::~Arena() { os::free_pages(memory_, bytes_); }

Arena::Arena(Arena&& other) noexcept
    : memory_(std::exchange(other.memory_, nullptr)),
      bytes_(std::exchange(other.bytes_, 0)),
      locked_(std::exchange(other.locked_, false)) {}

Arena& Arena::operator=(Arena&& other) noexcept {
  std::swap(memory_, other.memory_);
  std::swap(bytes_, other.bytes_);
  std::swap(locked_, other.locked_);
  return *this;
}

std::span<float> Arena::floats(std::size_t offset, std::size_t count) const {
  LCDM_CHECK(offset % sizeof(float) == 0 && offset <= bytes_ &&
             count <= (bytes_ - offset) / sizeof(float));
  void* begin = memory_ + offset;
  return {static_cast<float*>(begin), count};
}

}  // namespace lcdm
