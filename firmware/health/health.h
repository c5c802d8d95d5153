// What the running pipeline does, in numbers: counters, rates, ages and one state. Written by the
// capture and infer threads, read by anybody; no locks, no heap.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>

namespace lcdm {

enum class PipelineState : std::uint8_t {
  kStarting,   // no depth yet, and the camera has not failed
  kStreaming,  // depth is coming
  kNoSignal,   // the camera gives nothing: a declared wait, the pipeline keeps trying
  kNoCamera,   // no camera is there: a declared wait until it is plugged in
  kFault,      // everything was tried in vain: the owner ends the process, to be started again
  kFinished,   // a finite source came to its end
  kStopped,    // stop() was called, or never started
};

const char* to_string(PipelineState state);

// What is done about a camera that fails, from the least to the most.
enum class RecoveryRung : std::uint8_t {
  kRestartStream,   // stop and start, buffers and format as they are
  kReopen,          // close, configure, start
  kWaitForDevice,   // nothing to open: wait until the kernel reports a device, then reopen
  kResetPort,       // close, reset the USB device as if it were replugged, reopen
  kRestartProcess,  // give up: a new process finds what is wrong in this one cured
};
constexpr std::size_t kRecoveryRungs = 5;

const char* to_string(RecoveryRung rung);

// One reading. Times are nanoseconds of CLOCK_MONOTONIC, or durations; negative = not yet.
struct HealthSnapshot {
  PipelineState state = PipelineState::kStopped;
  std::uint64_t captured = 0;  // frames the camera gave
  std::uint64_t inferred = 0;  // frames that became depth
  std::uint64_t dropped = 0;   // frames that a newer one replaced, or a fault, before their turn
  std::uint64_t skipped = 0;   // frames that came while the processor rested
  std::uint64_t corrupt = 0;   // frames whose bytes were broken
  std::uint64_t failed = 0;    // frames the engine refused
  std::uint64_t timeouts = 0;  // waits for the camera that ended empty
  std::uint64_t prepared = 0;  // steps done towards engines: files read, weights packed
  std::uint64_t reopened = 0;  // times the camera was opened again after a fault
  std::array<std::uint64_t, kRecoveryRungs> recovery{};  // times each RecoveryRung was stepped on
  std::uint64_t resets_skipped = 0;  // port resets that were not possible: no port, no permission
  std::uint64_t sequence_gaps = 0;   // frames the source itself lost
  std::uint64_t sequence = 0;        // of the newest depth
  double frames_per_second = 0;      // of depth, over the last window
  std::int64_t frame_age_ns = -1;    // since the newest depth's pixels left the sensor
  std::int64_t latency_ns = -1;      // of the newest depth: from sensor to depth ready
  std::int64_t inference_p50_ns = -1;
  std::int64_t inference_p99_ns = -1;
  std::int64_t capture_heartbeat_age_ns = -1;
  std::int64_t infer_heartbeat_age_ns = -1;
};

// Each note_* belongs to the thread named beside it.
class Health {
 public:
  static constexpr std::size_t kWindow = 128;  // frames that rate and percentiles look back on

  void set_state(PipelineState state) { state_.store(state, std::memory_order_release); }
  PipelineState state() const { return state_.load(std::memory_order_acquire); }

  void note_captured(std::uint64_t sequence);                                 // capture
  void note_timeout() { add(timeouts_); }                                     // capture
  void note_reopened();                                                       // capture
  void note_recovery(RecoveryRung rung);                                      // capture
  void note_reset_skipped() { add(resets_skipped_); }                         // capture
  void note_damaged();                                                        // capture
  void note_corrupt() { add(corrupt_); }                                      // infer
  void note_failed() { add(failed_); }                                        // infer
  void note_skipped() { add(skipped_); }                                      // infer
  void note_prepared(std::int64_t now_ns);                                    // infer; a beat too
  void note_inferred(std::uint64_t sequence, std::int64_t sensor_ns,          // infer
                     std::int64_t inference_ns, std::int64_t done_ns);        //
  void set_dropped(std::uint64_t total) { dropped_.store(total, kRelaxed); }  // capture
  void beat_capture(std::int64_t now_ns) { capture_beat_ns_.store(now_ns, kRelaxed); }
  void beat_infer(std::int64_t now_ns) { infer_beat_ns_.store(now_ns, kRelaxed); }

  // Any thread. `now_ns` is CLOCK_MONOTONIC.
  HealthSnapshot snapshot(std::int64_t now_ns) const;

 private:
  static constexpr auto kRelaxed = std::memory_order_relaxed;
  using Counter = std::atomic<std::uint64_t>;

  static void add(Counter& counter) { counter.fetch_add(1, kRelaxed); }
  double rate(std::int64_t now_ns, std::uint64_t inferred) const;
  void percentiles(std::uint64_t inferred, HealthSnapshot& out) const;

  std::atomic<PipelineState> state_{PipelineState::kStopped};
  Counter captured_{0}, inferred_{0}, dropped_{0}, corrupt_{0}, failed_{0}, timeouts_{0};
  Counter reopened_{0}, resets_skipped_{0}, sequence_gaps_{0}, sequence_{0}, skipped_{0};
  Counter prepared_{0};
  std::array<Counter, kRecoveryRungs> recovery_{};
  std::atomic<std::int64_t> sensor_ns_{-1}, latency_ns_{-1};
  std::atomic<std::int64_t> capture_beat_ns_{-1}, infer_beat_ns_{-1};
  std::array<std::atomic<std::int64_t>, kWindow> inference_ns_{};  // ring by frame number
  std::array<std::atomic<std::int64_t>, kWindow> done_ns_{};       // the same ring
  std::uint64_t last_captured_sequence_ = 0;                       // capture thread only
  bool sequence_known_ = false;                                    // capture thread only
};

}  // namespace lcdm
