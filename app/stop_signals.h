// SIGINT and SIGTERM, taken by the main thread alone and when it asks.
#pragma once

#include <chrono>
#include <csignal>
#include <ctime>

namespace lcdm {

// Made before any thread is: threads inherit that the signals are blocked.
class StopSignals {
 public:
  StopSignals() {
    sigemptyset(&set_);
    sigaddset(&set_, SIGINT);
    sigaddset(&set_, SIGTERM);
    pthread_sigmask(SIG_BLOCK, &set_, nullptr);
  }

  // True when one of them came within `time`.
  bool wait_for(std::chrono::milliseconds time) const {
    const timespec timeout{time.count() / 1000, time.count() % 1000 * 1'000'000};
    return sigtimedwait(&set_, nullptr, &timeout) > 0;
  }

 private:
  sigset_t set_{};
};

}  // namespace lcdm
