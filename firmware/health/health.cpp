#include "firmware/health/health.h"

#include <algorithm>

namespace lcdm {
namespace {

// A depth older than this no longer belongs to a rate.
constexpr std::int64_t kRateWindowNs = 3'000'000'000;

std::int64_t age(std::int64_t now_ns, std::int64_t then_ns) {
  return then_ns < 0 ? -1 : std::max<std::int64_t>(0, now_ns - then_ns);
}

}  // namespace

const char* to_string(PipelineState state) {
  switch (state) {
    case PipelineState::kStarting:
      return "starting";
    case PipelineState::kStreaming:
      return "streaming";
    case PipelineState::kNoSignal:
      return "no signal";
    case PipelineState::kNoCamera:
      return "waiting for camera";
    case PipelineState::kFault:
      return "fault";
    case PipelineState::kFinished:
      return "finished";
    case PipelineState::kStopped:
      return "stopped";
  }
  return "unknown";
}

const char* to_string(RecoveryRung rung) {
  switch (rung) {
    case RecoveryRung::kRestartStream:
      return "stream restart";
    case RecoveryRung::kReopen:
      return "reopening";
    case RecoveryRung::kWaitForDevice:
      return "wait for device";
    case RecoveryRung::kResetPort:
      return "port reset";
    case RecoveryRung::kRestartProcess:
      return "process restart";
  }
  return "unknown";
}

void Health::note_captured(std::uint64_t sequence) {
  if (sequence_known_ && sequence > last_captured_sequence_ + 1) {
    sequence_gaps_.fetch_add(sequence - last_captured_sequence_ - 1, kRelaxed);
  }
  last_captured_sequence_ = sequence;
  sequence_known_ = true;
  add(captured_);
}

// A frame that came damaged is no lost one: its number is passed over.
void Health::note_damaged() {
  ++last_captured_sequence_;
  add(corrupt_);
}

void Health::note_reopened() {
  sequence_known_ = false;  // a source starts counting anew
  add(reopened_);
}

void Health::note_prepared(std::int64_t now_ns) {
  add(prepared_);
  beat_infer(now_ns);
}

void Health::note_recovery(RecoveryRung rung) { add(recovery_[static_cast<std::size_t>(rung)]); }

void Health::note_inferred(std::uint64_t sequence, std::int64_t sensor_ns,
                           std::int64_t inference_ns, std::int64_t done_ns) {
  const std::uint64_t number = inferred_.load(kRelaxed);
  inference_ns_[number % kWindow].store(inference_ns, kRelaxed);
  done_ns_[number % kWindow].store(done_ns, kRelaxed);
  sequence_.store(sequence, kRelaxed);
  sensor_ns_.store(sensor_ns, kRelaxed);
  latency_ns_.store(std::max<std::int64_t>(0, done_ns - sensor_ns), kRelaxed);
  // Release: a reader that sees the new count sees the new ring entries.
  inferred_.store(number + 1, std::memory_order_release);
}

HealthSnapshot Health::snapshot(std::int64_t now_ns) const {
  HealthSnapshot out;
  out.inferred = inferred_.load(std::memory_order_acquire);
  out.state = state();
  out.captured = captured_.load(kRelaxed);
  out.dropped = dropped_.load(kRelaxed);
  out.skipped = skipped_.load(kRelaxed);
  out.corrupt = corrupt_.load(kRelaxed);
  out.failed = failed_.load(kRelaxed);
  out.timeouts = timeouts_.load(kRelaxed);
  out.prepared = prepared_.load(kRelaxed);
  out.reopened = reopened_.load(kRelaxed);
  for (std::size_t i = 0; i < kRecoveryRungs; ++i) out.recovery[i] = recovery_[i].load(kRelaxed);
  out.resets_skipped = resets_skipped_.load(kRelaxed);
  out.sequence_gaps = sequence_gaps_.load(kRelaxed);
  out.sequence = sequence_.load(kRelaxed);
  out.frame_age_ns = age(now_ns, sensor_ns_.load(kRelaxed));
  out.latency_ns = latency_ns_.load(kRelaxed);
  out.capture_heartbeat_age_ns = age(now_ns, capture_beat_ns_.load(kRelaxed));
  out.infer_heartbeat_age_ns = age(now_ns, infer_beat_ns_.load(kRelaxed));
  out.frames_per_second = rate(now_ns, out.inferred);
  percentiles(out.inferred, out);
  return out;
}

double Health::rate(std::int64_t now_ns, std::uint64_t inferred) const {
  const auto held = std::min<std::uint64_t>(inferred, kWindow);
  std::int64_t oldest = now_ns;
  std::int64_t newest = 0;
  int recent = 0;
  for (std::uint64_t i = 0; i < held; ++i) {
    const std::int64_t done = done_ns_[i].load(kRelaxed);
    if (now_ns - done > kRateWindowNs) continue;
    oldest = std::min(oldest, done);
    newest = std::max(newest, done);
    ++recent;
  }
  return recent < 2 || newest <= oldest ? 0
                                        : (recent - 1) * 1e9 / static_cast<double>(newest - oldest);
}

void Health::percentiles(std::uint64_t inferred, HealthSnapshot& out) const {
  const auto held = static_cast<std::size_t>(std::min<std::uint64_t>(inferred, kWindow));
  if (held == 0) return;
  std::array<std::int64_t, kWindow> sorted{};
  for (std::size_t i = 0; i < held; ++i) sorted[i] = inference_ns_[i].load(kRelaxed);
  std::sort(sorted.begin(), sorted.begin() + static_cast<std::ptrdiff_t>(held));
  out.inference_p50_ns = sorted[(held - 1) / 2];
  out.inference_p99_ns = sorted[(held - 1) * 99 / 100];
}

}  // namespace lcdm
