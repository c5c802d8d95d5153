// Lends the camera's buffers out of the capture thread and collects them again.
//
// A camera owns N buffers. The capture thread dequeues one, lends it as a FrameRef and moves that
// on; when the last holder drops the FrameRef, on whatever thread, the buffer's index comes back to
// the capture thread, the only one that talks to the driver.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <optional>

#include "firmware/buffer/frame.h"

namespace lcdm {

class FramePool;

// Move-only ownership of one lent buffer. Dropping it gives the buffer back; never blocks.
class FrameRef {
 public:
  FrameRef() = default;
  FrameRef(FrameRef&& other) noexcept;
  FrameRef& operator=(FrameRef&& other) noexcept;
  FrameRef(const FrameRef&) = delete;
  FrameRef& operator=(const FrameRef&) = delete;
  ~FrameRef() { reset(); }

  explicit operator bool() const { return pool_ != nullptr; }
  const FrameView& view() const { return view_; }
  void reset();

 private:
  friend class FramePool;
  FrameRef(FramePool* pool, int index, const FrameView& view)
      : pool_(pool), index_(index), view_(view) {}

  FramePool* pool_ = nullptr;  // null: holds nothing
  int index_ = -1;
  FrameView view_;
};

// Each buffer is with the driver, lent, or returned and waiting for the capture thread: the three
// counts always add up to size(). Must outlive every FrameRef it lent.
class FramePool {
 public:
  static constexpr int kMaxBuffers = 32;
  enum class State : std::uint8_t { kDriver, kLent, kReturned };

  // `size` buffers, all with the driver.
  explicit FramePool(int size);

  int size() const { return size_; }
  int count(State state) const;

  // Capture thread only. The buffer must be with the driver; `view` describes its content.
  FrameRef lend(int index, const FrameView& view);
  // Capture thread only. The index of a returned buffer, now counted as with the driver again: the
  // caller queues it there. Empty when none has come back.
  std::optional<int> take_returned();

 private:
  friend class FrameRef;
  void give_back(int index);

  const int size_;
  std::array<std::atomic<State>, kMaxBuffers> states_{};
};

}  // namespace lcdm
