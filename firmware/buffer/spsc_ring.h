// A bounded queue between exactly one producer thread and one consumer thread. No locks, no heap.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <optional>
#include <utility>

namespace lcdm {

template <typename T, std::size_t kCapacity>
class SpscRing {
 public:
  // Producer only. False when full: the caller still owns the item and decides what to lose.
  [[nodiscard]] bool push(T item) {
    const std::size_t tail = tail_.load(std::memory_order_relaxed);
    if (tail - head_.load(std::memory_order_acquire) == kCapacity) return false;
    items_[tail % kCapacity] = std::move(item);
    tail_.store(tail + 1, std::memory_order_release);
    return true;
  }

  // Consumer only.
  std::optional<T> pop() {
    const std::size_t head = head_.load(std::memory_order_relaxed);
    if (head == tail_.load(std::memory_order_acquire)) return std::nullopt;
    std::optional<T> item(std::move(items_[head % kCapacity]));
    head_.store(head + 1, std::memory_order_release);
    return item;
  }

  // Of the moment; exact only on the consumer's thread.
  bool empty() const {
    return head_.load(std::memory_order_acquire) == tail_.load(std::memory_order_acquire);
  }

 private:
  std::array<T, kCapacity> items_{};
  alignas(64) std::atomic<std::size_t> head_{0};  // next to pop
  alignas(64) std::atomic<std::size_t> tail_{0};  // next to push
};

}  // namespace lcdm
