// Which rung to step on when the camera fails, and how long to wait before. Decides only: no
// clock, no threads, no camera.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>

#include "firmware/base/status.h"
#include "firmware/health/health.h"

namespace lcdm {

struct RecoveryOptions {
  // The wait before a step: doubles from first to last, and begins anew after depth for as long as
  // the last one, so that even a device that fails again and again is not tried more often.
  std::chrono::milliseconds first_backoff{100};
  std::chrono::milliseconds last_backoff{1000};
  // How often the camera is reopened before its port is reset, and again after each reset.
  int reopenings = 3;
  // Depth for so long without a fault: the next fault begins at the bottom.
  std::chrono::milliseconds steady_after{10'000};
  // Nothing helped for so long since the last depth: the process is restarted.
  std::chrono::milliseconds give_up_after{60'000};
};

struct RecoveryStep {
  RecoveryRung rung;
  std::chrono::milliseconds wait;  // before it
};

// A device that is there but fails: its stream is restarted once, then it is reopened, then its
// port is reset and it is reopened, over and over until `give_up_after`. A device that is not there
// is waited for, for ever; one that is kept from us (kUnavailable) is reopened, for ever. Times are
// CLOCK_MONOTONIC. Used from one thread.
class RecoveryLadder {
 public:
  RecoveryLadder(const RecoveryOptions& options, std::int64_t now_ns)
      : options_(options), last_depth_ns_(now_ns), last_call_ns_(now_ns) {}

  // A frame became depth: the camera works.
  void note_depth(std::int64_t now_ns);

  // Nothing is open whose stream could be restarted: that step is passed over.
  void note_nothing_open() { steps_ = std::max(steps_, 1); }

  // The camera failed, or the last step did: what to do next.
  RecoveryStep next(StatusCode fault, std::int64_t now_ns);

 private:
  std::chrono::milliseconds backoff();

  RecoveryOptions options_;
  // The time without depth counts from here: the last depth, moved on by how long the device was
  // away or kept from us since. Each reset takes it away for a moment; were that a new beginning, a
  // process that no reset helps would never end.
  std::int64_t last_depth_ns_;
  std::int64_t last_call_ns_;         // of next()
  std::int64_t depth_since_ns_ = -1;  // without a fault; negative: none since the last one
  int steps_ = 0;                     // on devices that are there, since depth was steady
  int waits_ = 0;                     // steps of any kind since the wait began anew
};

}  // namespace lcdm
