#include "firmware/health/supervisor.h"

#include <algorithm>
#include <cstdarg>
#include <cstdio>
#include <cstring>

namespace lcdm {
namespace {

// A source that gave a frame this recently gives frames: no depth then is our own fault.
constexpr std::int64_t kFramesComeNs = 1'500'000'000;
// As long as two periods of the slowest rate that may be configured: refused all the time.
constexpr std::int64_t kRefusedNs = 4'000'000'000;
// The pipeline's threads live in this order, after main.
constexpr std::array<const char*, 3> kVitalThreads = {"main", "capture", "infer"};

// Bits of Finding::losses, after those of the outputs.
constexpr std::size_t kOutputEnded = Supervisor::kMaxOutputs;
constexpr std::size_t kEffortLowered = kOutputEnded + 1;  // and how far: one for each effort

// Whether the pipeline says that the camera gives nothing.
bool gives_nothing(PipelineState state) {
  return state == PipelineState::kNoSignal || state == PipelineState::kNoCamera ||
         state == PipelineState::kFinished;
}

double seconds(std::int64_t ns) { return static_cast<double>(ns) * 1e-9; }

}  // namespace

const char* to_string(DeviceState state) {
  switch (state) {
    case DeviceState::kBooting:
      return "booting";
    case DeviceState::kWaitingForCamera:
      return "waiting for camera";
    case DeviceState::kStreaming:
      return "streaming";
    case DeviceState::kRecording:
      return "recording";
    case DeviceState::kDegraded:
      return "degraded";
    case DeviceState::kFault:
      return "fault";
  }
  return "unknown";
}

Supervisor::Finding::Finding(DeviceState found, const char* format, ...) : state(found) {
  va_list arguments;
  va_start(arguments, format);
  // As in status.cpp. NOLINTNEXTLINE(clang-analyzer-valist.Uninitialized)
  std::vsnprintf(reason, sizeof(reason), format, arguments);
  va_end(arguments);
}

void Supervisor::Finding::lose(std::size_t bit, const char* format, ...) {
  char text[Status::kMaxText];
  va_list arguments;
  va_start(arguments, format);
  // As in status.cpp. NOLINTNEXTLINE(clang-analyzer-valist.Uninitialized)
  std::vsnprintf(text, sizeof(text), format, arguments);
  va_end(arguments);
  const std::size_t used = std::strlen(reason);
  std::snprintf(reason + used, sizeof(reason) - used, "%s%s", used == 0 ? "" : "; ", text);
  state = DeviceState::kDegraded;
  losses |= 1U << bit;
}

const Judgement& Supervisor::judge(const Observation& seen) {
  follow_progress(seen);
  count_missed(seen);
  follow_output_fault(seen);
  const std::int64_t silence = seen.now_ns - last_progress_ns_;
  judgement_.alive = late_vital() == nullptr && silence <= options_.depth_deadline_ns;
  judgement_.ready = judgement_.ready || waiting_ || seen.pipeline.inferred > 0;
  const Finding now = find(seen);
  const bool other_state = !begun_ || now.state != judgement_.state;
  judgement_.changed = other_state || now.losses != losses_;
  judgement_.changes += begun_ && other_state ? 1 : 0;
  judgement_.state = now.state;
  std::copy(std::begin(now.reason), std::end(now.reason), std::begin(judgement_.reason));
  losses_ = now.losses;
  begun_ = true;
  return judgement_;
}

// Depth that comes is progress, and so is each step towards an engine for a camera that came back
// different; so is every moment in which it cannot come, because the camera gives nothing and the
// pipeline says so.
void Supervisor::follow_progress(const Observation& seen) {
  const HealthSnapshot& pipeline = seen.pipeline;
  main_gap_ns_ = begun_ ? seen.now_ns - last_call_ns_ : 0;
  last_call_ns_ = seen.now_ns;
  if (pipeline.captured != captured_) last_frame_ns_ = seen.now_ns;
  // A camera whose pictures are broken gives nothing either: the ladder has its time with it.
  if (pipeline.corrupt != corrupt_) last_broken_ns_ = seen.now_ns;
  if (pipeline.failed != failed_) last_refused_ns_ = seen.now_ns;
  const auto within = [&](std::int64_t limit_ns, std::int64_t when_ns) {
    return when_ns >= 0 && seen.now_ns - when_ns < limit_ns;
  };
  const bool whole =
      within(kFramesComeNs, last_frame_ns_) && !within(kFramesComeNs, last_broken_ns_);
  waiting_ = gives_nothing(pipeline.state) && !whole && !within(kRefusedNs, last_refused_ns_);
  const bool nearer = pipeline.inferred != inferred_ || pipeline.prepared != prepared_;
  if (!begun_ || waiting_ || nearer) last_progress_ns_ = seen.now_ns;
  captured_ = pipeline.captured;
  corrupt_ = pipeline.corrupt;
  failed_ = pipeline.failed;
  inferred_ = pipeline.inferred;
  prepared_ = pipeline.prepared;
}

// Each miss once, however long it lasts.
void Supervisor::count_missed(const Observation& seen) {
  const std::array<std::int64_t, 3> vital = {main_gap_ns_, seen.pipeline.capture_heartbeat_age_ns,
                                             seen.pipeline.infer_heartbeat_age_ns};
  for (std::size_t i = 0; i < vital.size(); ++i) {
    const bool late = vital[i] > options_.vital_deadline_ns;
    judgement_.missed_vital += late && !vital_late_[i] ? 1 : 0;
    vital_late_[i] = late;
  }
  LCDM_CHECK(seen.outputs.size() <= output_late_.size());
  for (std::size_t i = 0; i < seen.outputs.size(); ++i) {
    const bool late = seen.outputs[i].age_ns > options_.output_deadline_ns;
    judgement_.missed_outputs += late && !output_late_[i] ? 1 : 0;
    output_late_[i] = late;
  }
}

void Supervisor::follow_output_fault(const Observation& seen) {
  if (seen.output_fault[0] == 0) {
    output_fault_since_ns_ = -1;
  } else if (output_fault_since_ns_ < 0) {
    output_fault_since_ns_ = seen.now_ns;
  }
}

const char* Supervisor::late_vital() const {
  for (std::size_t i = 0; i < vital_late_.size(); ++i) {
    if (vital_late_[i]) return kVitalThreads[i];
  }
  return nullptr;
}

Supervisor::Finding Supervisor::find(const Observation& seen) const {
  if (!judgement_.alive) return find_fault(seen);
  switch (seen.pipeline.state) {
    case PipelineState::kFault:
      return {DeviceState::kFault, "nothing brings the camera back: %s", seen.fault};
    case PipelineState::kNoSignal:
    case PipelineState::kNoCamera:
    case PipelineState::kFinished:
      return {DeviceState::kWaitingForCamera, "%s", seen.fault};
    case PipelineState::kStarting:
    case PipelineState::kStopped:
      return {DeviceState::kBooting, "%s", seen.fault};
    case PipelineState::kStreaming:
      break;
  }
  return find_loss(seen);
}

Supervisor::Finding Supervisor::find_fault(const Observation& seen) const {
  if (const char* thread = late_vital()) {
    return {DeviceState::kFault, "thread %s gives no sign of life", thread};
  }
  return {DeviceState::kFault, "frames come, but no depth for %.0f s%s%s",
          seconds(seen.now_ns - last_progress_ns_), seen.fault[0] == 0 ? "" : ": ", seen.fault};
}

// While depth comes: what else is lost.
Supervisor::Finding Supervisor::find_loss(const Observation& seen) const {
  Finding found(seen.recording ? DeviceState::kRecording : DeviceState::kStreaming, "%s", "");
  for (std::size_t i = 0; i < seen.outputs.size(); ++i) {
    if (!output_late_[i]) continue;
    found.lose(i, "thread %s gives no sign of life: its output is lost", seen.outputs[i].thread);
  }
  if (output_fault_since_ns_ >= 0 &&
      seen.now_ns - output_fault_since_ns_ < options_.output_fault_ns) {
    found.lose(kOutputEnded, "%s", seen.output_fault);
  }
  if (seen.effort != Effort::kFull) {
    found.lose(kEffortLowered + static_cast<std::size_t>(seen.effort), "%s: %s",
               to_string(seen.effort), seen.effort_reason);
  }
  return found;
}

}  // namespace lcdm
