// One thread's sign of life.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>

namespace lcdm {

// beat and rest belong to the thread whose heart it is, age to any. Times are nanoseconds of
// CLOCK_MONOTONIC.
class Heartbeat {
 public:
  void beat(std::int64_t now_ns) { last_ns_.store(now_ns, std::memory_order_relaxed); }
  // From here on the thread waits for work, for as long as that takes: no age until it beats again.
  void rest() { last_ns_.store(-1, std::memory_order_relaxed); }

  // Nanoseconds since the last beat; negative while the thread rests or before its first.
  std::int64_t age_ns(std::int64_t now_ns) const {
    const std::int64_t last = last_ns_.load(std::memory_order_relaxed);
    return last < 0 ? -1 : std::max<std::int64_t>(0, now_ns - last);
  }

 private:
  std::atomic<std::int64_t> last_ns_{-1};
};

}  // namespace lcdm
