// A hand-off of depth 1: the latest item wins, an item nobody took is dropped and counted.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <optional>
#include <utility>

namespace lcdm {

// Any number of threads may put and take. The lock is held for a move only, never while anybody
// works on an item.
template <typename T>
class Mailbox {
 public:
  // Replaces what is waiting; the replaced item is destroyed on this thread, outside the lock.
  void put(T item) {
    std::optional<T> overwritten(std::move(item));
    {
      const std::lock_guard lock(mutex_);
      std::swap(slot_, overwritten);
      if (overwritten) ++dropped_;
    }
    filled_.notify_one();
  }

  // Waits up to `timeout` for an item. Empty on time-out or when closed.
  std::optional<T> take(std::chrono::nanoseconds timeout) {
    std::unique_lock lock(mutex_);
    filled_.wait_for(lock, timeout, [this] { return slot_.has_value() || closed_; });
    return std::exchange(slot_, std::nullopt);
  }

  // Drops what is waiting, on this thread.
  void clear() {
    std::optional<T> dropped;
    const std::lock_guard lock(mutex_);
    std::swap(slot_, dropped);
    if (dropped) ++dropped_;
  }

  // Wakes every waiter for good.
  void close() {
    {
      const std::lock_guard lock(mutex_);
      closed_ = true;
    }
    filled_.notify_all();
  }

  // Items that were replaced or cleared.
  std::uint64_t dropped() const {
    const std::lock_guard lock(mutex_);
    return dropped_;
  }

 private:
  mutable std::mutex mutex_;
  std::condition_variable filled_;
  std::optional<T> slot_;
  std::uint64_t dropped_ = 0;
  bool closed_ = false;
};

}  // namespace lcdm
