#include "firmware/buffer/frame_pool.h"

#include <utility>

#include "firmware/base/check.h"

namespace lcdm {

FrameRef::FrameRef(FrameRef&& other) noexcept
    : pool_(std::exchange(other.pool_, nullptr)), index_(other.index_), view_(other.view_) {}

FrameRef& FrameRef::operator=(FrameRef&& other) noexcept {
  if (this == &other) return *this;
  reset();
  pool_ = std::exchange(other.pool_, nullptr);
  index_ = other.index_;
  view_ = other.view_;
  return *this;
}

void FrameRef::reset() {
  if (FramePool* pool = std::exchange(pool_, nullptr)) pool->give_back(index_);
}

FramePool::FramePool(int size) : size_(size) { LCDM_CHECK(size > 0 && size <= kMaxBuffers); }

int FramePool::count(State state) const {
  int found = 0;
  for (int i = 0; i < size_; ++i) found += states_[i].load(std::memory_order_acquire) == state;
  return found;
}

FrameRef FramePool::lend(int index, const FrameView& view) {
  LCDM_CHECK(index >= 0 && index < size_);
  const State before = states_[index].exchange(State::kLent, std::memory_order_acq_rel);
  LCDM_CHECK(before == State::kDriver);
  return {this, index, view};
}

void FramePool::give_back(int index) {
  // Release: what the holder read from the buffer happens before the driver writes it again.
  const State before = states_[index].exchange(State::kReturned, std::memory_order_acq_rel);
  LCDM_CHECK(before == State::kLent);
}

std::optional<int> FramePool::take_returned() {
  for (int i = 0; i < size_; ++i) {
    State expected = State::kReturned;
    if (states_[i].compare_exchange_strong(expected, State::kDriver, std::memory_order_acq_rel)) {
      return i;
    }
  }
  return std::nullopt;
}

}  // namespace lcdm
