// Watches the depth that a running `lcdm` serves, as a viewer that reads all the time, and keeps
// the moment of every frame that became depth: its stamp, which no slowness on the way to us moves.
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "firmware/base/os.h"
#include "tests/app/raw_client.h"

namespace lcdm::test {

// Times are CLOCK_MONOTONIC.
class DepthWatcher {
 public:
  explicit DepthWatcher(int port) : port_(port), thread_([this] { watch(); }) {}
  ~DepthWatcher() {
    stopping_ = true;
    thread_.join();
  }
  DepthWatcher(const DepthWatcher&) = delete;
  DepthWatcher& operator=(const DepthWatcher&) = delete;

  // The moment of the second depth after `begin_ns`: it flows. Empty when none comes within `wait`.
  std::optional<std::int64_t> flows_after(std::int64_t begin_ns, std::chrono::seconds wait) const {
    const std::int64_t end_ns = os::monotonic_ns() + std::chrono::nanoseconds(wait).count();
    while (os::monotonic_ns() < end_ns) {
      if (const auto found = second_after(begin_ns)) return found;
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    return std::nullopt;
  }

  // The longest time without depth from one moment to another.
  std::int64_t longest_gap_ns(std::int64_t begin_ns, std::int64_t end_ns) const {
    const std::lock_guard lock(mutex_);
    std::int64_t last = begin_ns;
    std::int64_t longest = 0;
    for (auto each = after(begin_ns); each != moments_.end() && *each < end_ns; ++each) {
      longest = std::max(longest, *each - last);
      last = *each;
    }
    return std::max(longest, end_ns - last);
  }

 private:
  std::vector<std::int64_t>::const_iterator after(std::int64_t moment_ns) const {
    return std::upper_bound(moments_.begin(), moments_.end(), moment_ns);
  }

  std::optional<std::int64_t> second_after(std::int64_t begin_ns) const {
    const std::lock_guard lock(mutex_);
    const auto first = after(begin_ns);
    if (moments_.end() - first < 2) return std::nullopt;
    return first[1];
  }

  void watch() {
    while (!stopping_) watch_until_cut();
  }

  // The server lets us hear something every second, unless it took us for a stalled client: on a
  // machine that did not let us read.
  void watch_until_cut() {
    constexpr std::int64_t kCutAfterNs = 2'500'000'000;
    RawClient client(port_);
    client.send("GET /stream.mjpg?view=depth HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n");
    std::string unread;
    std::int64_t heard_ns = os::monotonic_ns();
    while (!stopping_ && os::monotonic_ns() - heard_ns < kCutAfterNs) {
      const std::string more = client.read(10);
      if (more.empty()) {
        std::this_thread::sleep_for(std::chrono::milliseconds(1));  // at once when we are cut
        continue;
      }
      heard_ns = os::monotonic_ns();
      unread += more;
      take_stamps(unread);
    }
  }

  // Out of the heads of the parts, whole ones only; the rest stays.
  void take_stamps(std::string& unread) {
    const std::string mark = "X-Frame-Stamp: ";
    std::size_t done = 0;
    std::size_t rest = unread.size() - std::min(unread.size(), mark.size());  // half a mark
    for (std::size_t at; (at = unread.find(mark, done)) != std::string::npos;) {
      const std::size_t end = unread.find('\r', at);
      if (end == std::string::npos) {
        rest = at;
        break;
      }
      const std::int64_t unix_ns = std::stoll(unread.substr(at + mark.size(), end - at));
      const std::lock_guard lock(mutex_);
      moments_.push_back(unix_ns - os::unix_offset_ns());
      done = end;
    }
    unread.erase(0, std::max(done, rest));
  }

  const int port_;
  std::atomic<bool> stopping_{false};
  mutable std::mutex mutex_;
  std::vector<std::int64_t> moments_;  // rising
  std::thread thread_;
};

}  // namespace lcdm::test
