// What state the device is in, and whether it may tell the watchdog that it lives. Pure: it is
// shown everything and asks nobody, so a test can play any day in a moment.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "firmware/base/status.h"
#include "firmware/health/degrade_ladder.h"
#include "firmware/health/health.h"

namespace lcdm {

enum class DeviceState : std::uint8_t {
  kBooting,           // no depth yet
  kWaitingForCamera,  // a declared wait: outputs are up and say `no signal`
  kStreaming,         // depth is coming
  kRecording,         // and is being recorded
  kDegraded,          // depth is coming, but something is lost: the reason says what
  kFault,             // depth should come and does not: the watchdog is not told that we live
};
constexpr std::size_t kDeviceStates = 6;

const char* to_string(DeviceState state);

// A thread that serves an output. When it hangs that output is lost, never the depth.
struct OutputPulse {
  const char* thread = "";
  std::int64_t age_ns = -1;  // since its last sign of life; negative: it rests
};

// Everything the supervisor is shown. Texts are borrowed for the call.
struct Observation {
  std::int64_t now_ns = 0;
  HealthSnapshot pipeline;               // with the heartbeats of capture and infer
  const char* fault = "";                // why the pipeline gives no depth
  std::span<const OutputPulse> outputs;  // always the same threads, in the same order
  bool recording = false;
  const char* output_fault = "";  // why an output ended by itself
  Effort effort = Effort::kFull;
  const char* effort_reason = "";
};

struct SupervisorOptions {
  // A vital thread (main, capture, infer) without a sign of life for this long hangs. The slowest
  // network on the slowest board needs less for a frame.
  std::int64_t vital_deadline_ns = 10'000'000'000;
  // The same for a thread that serves an output. A slow disk is not a dead one.
  std::int64_t output_deadline_ns = 10'000'000'000;
  // An output that ended by itself degrades the device for this long: it will not begin again by
  // itself, and the status goes on saying what became of it.
  std::int64_t output_fault_ns = 60'000'000'000;
  // Frames come, but no depth and no step towards an engine, for this long. Longer than three
  // periods of the slowest rate that may be configured: then the camera is silent.
  std::int64_t depth_deadline_ns = 10'000'000'000;
};

struct Judgement {
  DeviceState state = DeviceState::kBooting;
  char reason[Status::kMaxText] = {};  // why; empty when all is well
  bool changed = false;                // state, or what is lost, differs from the last judgement's
  bool ready = false;                  // depth has come, or a wait for the camera was declared
  bool alive = true;                   // the watchdog may be told so
  std::uint64_t changes = 0;           // of the state so far
  std::uint64_t missed_vital = 0;      // deadlines that vital threads have missed
  std::uint64_t missed_outputs = 0;    // and threads that serve an output
};

// Belongs to one thread: main.
class Supervisor {
 public:
  static constexpr std::size_t kMaxOutputs = 8;

  explicit Supervisor(const SupervisorOptions& options = {}) : options_(options) {}

  // One look; main calls it several times a second, for as long as it lives. A gap between two
  // calls that is longer than the vital deadline counts as missed by main.
  const Judgement& judge(const Observation& seen);

 private:
  // A state, and why. Of what is lost while depth comes, everything.
  struct Finding {
    DeviceState state;
    char reason[Status::kMaxText] = {};
    std::uint32_t losses = 0;  // a bit each, so that another loss of the same state is a change
    __attribute__((format(printf, 3, 4))) Finding(DeviceState found, const char* format, ...);
    __attribute__((format(printf, 3, 4))) void lose(std::size_t bit, const char* format, ...);
  };

  void follow_progress(const Observation& seen);
  void count_missed(const Observation& seen);
  void follow_output_fault(const Observation& seen);
  const char* late_vital() const;
  Finding find(const Observation& seen) const;
  Finding find_fault(const Observation& seen) const;
  Finding find_loss(const Observation& seen) const;

  const SupervisorOptions options_;
  Judgement judgement_;
  bool begun_ = false;
  std::uint32_t losses_ = 0;
  std::int64_t last_call_ns_ = 0;
  std::int64_t main_gap_ns_ = 0;  // between the last two calls
  std::uint64_t captured_ = 0;
  std::uint64_t corrupt_ = 0;
  std::uint64_t failed_ = 0;
  std::uint64_t inferred_ = 0;
  std::uint64_t prepared_ = 0;
  std::int64_t last_frame_ns_ = -1;    // when `captured` last rose
  std::int64_t last_broken_ns_ = -1;   // when a picture that could not be decoded was last seen
  std::int64_t last_refused_ns_ = -1;  // when the engine last refused one that was whole
  std::int64_t last_progress_ns_ = 0;  // when depth last came or came nearer, or could not come
  std::int64_t output_fault_since_ns_ = -1;  // negative: there is none
  bool waiting_ = false;                     // declared, and no frame comes
  std::array<bool, 3> vital_late_{};         // main, capture, infer
  std::array<bool, kMaxOutputs> output_late_{};
};

}  // namespace lcdm
