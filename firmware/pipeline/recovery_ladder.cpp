#include "firmware/pipeline/recovery_ladder.h"

#include <algorithm>

namespace lcdm {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;

}  // namespace

void RecoveryLadder::note_depth(std::int64_t now_ns) {
  last_depth_ns_ = now_ns;
  if (depth_since_ns_ < 0) depth_since_ns_ = now_ns;
}

RecoveryStep RecoveryLadder::next(StatusCode fault, std::int64_t now_ns) {
  const nanoseconds depth(depth_since_ns_ < 0 ? 0 : last_depth_ns_ - depth_since_ns_);
  if (depth >= options_.last_backoff) waits_ = 0;
  if (depth >= options_.steady_after) steps_ = waits_ = 0;
  depth_since_ns_ = -1;
  const std::int64_t since_ns = now_ns - std::max(last_call_ns_, last_depth_ns_);
  last_call_ns_ = now_ns;

  if (fault == StatusCode::kNotFound || fault == StatusCode::kDeviceGone) {
    last_depth_ns_ += since_ns;  // its absence is nothing that a new process would cure
    note_nothing_open();
    return {RecoveryRung::kWaitForDevice, backoff()};
  }
  // A source that changed its format, that another program holds or that may not be opened: what is
  // mapped is of no use, and neither a reset of its port nor a new process would cure it.
  if (fault == StatusCode::kUnavailable) {
    last_depth_ns_ += since_ns;
    ++steps_;
    return {RecoveryRung::kReopen, backoff()};
  }
  if (nanoseconds(now_ns - last_depth_ns_) >= options_.give_up_after) {
    return {RecoveryRung::kRestartProcess, milliseconds(0)};
  }
  const milliseconds wait = backoff();
  const int step = steps_++;
  if (step == 0) return {RecoveryRung::kRestartStream, wait};
  const bool reset = step % (options_.reopenings + 1) == 0;
  return {reset ? RecoveryRung::kResetPort : RecoveryRung::kReopen, wait};
}

milliseconds RecoveryLadder::backoff() {
  constexpr int kMostDoublings = 16;
  const milliseconds wait = options_.first_backoff * (1 << std::min(waits_, kMostDoublings));
  ++waits_;
  return std::min(wait, options_.last_backoff);
}

}  // namespace lcdm
