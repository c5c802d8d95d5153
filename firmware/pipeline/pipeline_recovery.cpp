// What the capture thread does when no frame comes: judges the silence and climbs the recovery
// ladder. The outputs stay up meanwhile and say so, with the age of the last depth.
#include <algorithm>
#include <cerrno>
#include <future>

#include "firmware/base/alloc_watch.h"
#include "firmware/base/os.h"
#include "firmware/pipeline/pipeline.h"

namespace lcdm {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;

// After a broken frame, so that a source of nothing but broken frames does not spin.
constexpr milliseconds kPauseAfterCorrupt{5};
// Between two looks whether the pipeline stops.
constexpr milliseconds kNap{20};
// What drivers may take for one step: a dead camera's controls 5 s each, a reset of its port more.
constexpr nanoseconds kLongestStep = std::chrono::seconds(90);

bool is_absence(StatusCode code) {
  return code == StatusCode::kNotFound || code == StatusCode::kDeviceGone;
}

// For the ladder. A camera that another program holds, or that may not be opened, is not broken.
StatusCode kind_of(const Status& fault) {
  const int error = fault.sys_errno();
  const bool denied = error == EBUSY || error == EACCES || error == EPERM;
  return denied ? StatusCode::kUnavailable : fault.code();
}

}  // namespace

bool Pipeline::survive(const Status& status) {
  switch (status.code()) {
    case StatusCode::kTimeout:
      health_.note_timeout();
      return judge_silence(status);
    case StatusCode::kCorrupt:
      health_.note_damaged();
      std::this_thread::sleep_for(kPauseAfterCorrupt);
      return judge_silence(status);
    case StatusCode::kEndOfStream:
      wait_until_nothing_is_lent();
      health_.set_state(PipelineState::kFinished);
      return false;
    default:
      return recover(status);
  }
}

// Declares the wait for frames, and does something about it when it lasts.
bool Pipeline::judge_silence(const Status& status) {
  const nanoseconds silence(os::monotonic_ns() - last_frame_ns_);
  if (silence < std::max(options_.no_signal_after, three_periods_)) return true;
  health_.set_state(PipelineState::kNoSignal);
  set_fault(status.text());
  return silence < std::max(patience(), three_periods_) || recover(status);
}

// Frames come. Whether the camera works shows when they become depth.
bool Pipeline::judge_depth() {
  if (only_corrupt_.exchange(false)) {
    alloc_watch::unseal_thread();
    return recover(Status::error(StatusCode::kCorrupt, "frames come, but none can be decoded: %s",
                                 fault().c_str()));
  }
  const std::int64_t depth_ns = last_depth_ns_;
  if (depth_ns != seen_depth_ns_) ladder_.note_depth(depth_ns);
  seen_depth_ns_ = depth_ns;
  return true;
}

// Takes one rung after the other until the camera streams again, the pipeline stops, or the ladder
// ends: then the state is kFault, and the rest is the owner's.
bool Pipeline::recover(Status fault) {
  alloc_watch::unseal_thread();
  stop_camera();
  if (!pool_) ladder_.note_nothing_open();
  while (!fault.is_ok() && !stopping_) {
    if (is_absence(fault.code())) camera_.close();
    declare(fault);
    const RecoveryStep step = ladder_.next(kind_of(fault), os::monotonic_ns());
    health_.note_recovery(step.rung);
    if (step.rung == RecoveryRung::kRestartProcess) {
      health_.set_state(PipelineState::kFault);
      return false;
    }
    if (!wait_before(step)) return true;
    fault = climb_alive(step.rung);
    if (!fault) camera_.stop();
  }
  last_frame_ns_ = os::monotonic_ns();
  last_depth_ns_ = last_frame_ns_;  // what came before does not count against the camera now
  seen_depth_ns_ = last_frame_ns_;
  flowed_ = only_corrupt_ = false;
  return true;
}

// False as soon as the pipeline stops.
bool Pipeline::wait_before(const RecoveryStep& step) {
  const std::int64_t end = os::monotonic_ns() + nanoseconds(step.wait).count();
  const bool arrives = step.rung == RecoveryRung::kWaitForDevice && options_.port != nullptr;
  while (!stopping_ && os::monotonic_ns() < end) {
    health_.beat_capture(os::monotonic_ns());
    const milliseconds nap = std::min(step.wait, kNap);
    if (!arrives) {
      std::this_thread::sleep_for(nap);
    } else if (options_.port->wait_for_arrival(nap)) {
      break;
    }
  }
  return !stopping_;
}

// The heart beats while a driver is at work, so that nobody kills the program on the rung that
// would cure the camera.
Status Pipeline::climb_alive(RecoveryRung rung) {
  std::future<Status> climbed = std::async(std::launch::async, [this, rung] {
    os::set_thread_name("recover");
    return climb(rung);
  });
  const std::int64_t end = os::monotonic_ns() + kLongestStep.count();
  while (climbed.wait_for(kNap) != std::future_status::ready) {
    if (os::monotonic_ns() < end) health_.beat_capture(os::monotonic_ns());
  }
  return climbed.get();
}

Status Pipeline::climb(RecoveryRung rung) {
  if (rung == RecoveryRung::kResetPort) reset_port();
  if (rung == RecoveryRung::kRestartStream) {
    pool_.emplace(camera_.buffer_count());
    return camera_.start();
  }
  LCDM_RETURN_IF_ERROR(configure_camera());
  LCDM_RETURN_IF_ERROR(camera_.start());
  if (health_.state() == PipelineState::kNoCamera) {
    set_fault("");
    health_.set_state(PipelineState::kStarting);
  }
  health_.note_reopened();
  return Status::ok();
}

// A port that cannot be reset is passed over: reopening comes next anyway.
void Pipeline::reset_port() {
  // The camera's own words, not source()'s: one that could never be opened is in none.
  const std::string usb = camera_.info().usb;
  camera_.close();
  if (options_.port == nullptr || !options_.port->reset(usb)) health_.note_reset_skipped();
}

void Pipeline::declare(const Status& fault) {
  health_.set_state(is_absence(fault.code()) ? PipelineState::kNoCamera : PipelineState::kNoSignal);
  set_fault(fault.text());
}

}  // namespace lcdm
