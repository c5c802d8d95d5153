#include "app/service.h"

#include <array>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <future>
#include <string>
#include <utility>

#include "firmware/base/exit_code.h"
#include "firmware/base/os.h"

namespace lcdm {
namespace {

constexpr std::chrono::milliseconds kLookPeriod{50};
// `systemctl status` shows figures no older than this.
constexpr std::int64_t kStatusLineNs = 10'000'000'000;
constexpr std::int64_t kHeatPeriodNs = 1'000'000'000;
// Whoever resets the board when its heart stops need not wait longer for a start.
constexpr std::int64_t kLongestStartNs = 60'000'000'000;
constexpr std::chrono::seconds kLongestEnd{1};

// "streaming, 12.3 depths/s", "waiting for camera: /dev/video0 is not there".
std::string status_line(const Judgement& now, double rate) {
  std::string line = to_string(now.state);
  if (now.reason[0] != 0) line += std::string(": ") + now.reason;
  if (!gives_depth(now.state) || rate <= 0) return line;
  char figures[32];
  std::snprintf(figures, sizeof(figures), ", %.1f depths/s", rate);
  return line + figures;
}

// In a driver's hands nothing but the end of the process ends it.
template <typename T>
void end_with(const std::future<T>& work, int exit_code) {
  if (work.wait_for(kLongestEnd) == std::future_status::ready) return;
  std::fflush(stdout);
  std::_Exit(exit_code);
}

}  // namespace

bool gives_depth(DeviceState state) {
  return state == DeviceState::kStreaming || state == DeviceState::kRecording ||
         state == DeviceState::kDegraded;
}

Service::Service(Pipeline& pipeline, const LiveView& view, Recorder& recorder, const Config& config,
                 const std::string& sysfs)
    : pipeline_(pipeline),
      view_(view),
      recorder_(recorder),
      thermal_(sysfs),
      huge_pages_(os::gives_huge_pages(sysfs)),
      control_(pipeline, recorder),
      panel_(config.gpio),
      ladder_(config.service.least_rate) {
  notify_.status(to_string(DeviceState::kBooting));
}

Status Service::start(const StopSignals& signals) {
  std::future<Status> started = std::async(std::launch::async, [this] {
    os::set_thread_name("start");
    return pipeline_.start();
  });
  const std::int64_t begin_ns = os::monotonic_ns();
  while (started.wait_for(std::chrono::seconds(0)) != std::future_status::ready) {
    Judgement booting;
    const std::int64_t now_ns = os::monotonic_ns();
    booting.alive = now_ns - begin_ns < kLongestStartNs;
    show(booting, now_ns);
    if (!signals.wait_for(kLookPeriod)) continue;
    stopped_ = true;
    panel_.release();
    notify_.stopping("stopping");
    end_with(started, kExitOk);  // nothing is recorded yet
  }
  return started.get();
}

void Service::end(int exit_code) {
  const std::future<void> ended = std::async(std::launch::async, [this] { pipeline_.stop(); });
  end_with(ended, exit_code);
}

Status Service::run(const StopSignals& signals) {
  if (stopped_) return Status::ok();
  look();
  Status status;
  while (status && !signals.wait_for(kLookPeriod)) {
    const PipelineState state = pipeline_.health().state();
    look();  // after it: what ends this is told
    if (state == PipelineState::kFinished) break;
    if (state == PipelineState::kFault) {
      status = Status::error(StatusCode::kIoError, "nothing brings the camera back; start again");
    }
  }
  panel_.release();
  notify_.stopping(status ? "stopping" : "restart: nothing brings the camera back");
  return status;
}

ServiceStatus Service::status() const {
  const std::lock_guard lock(mutex_);
  return status_;
}

void Service::look() {
  const std::int64_t now_ns = os::monotonic_ns();
  const HealthSnapshot pipeline = pipeline_.health().snapshot(now_ns);
  const std::string fault = pipeline_.fault();  // after it: why each step in it was taken
  const RecorderStatus recorder = recorder_.status();
  const std::array<OutputPulse, 4> outputs = {
      {{"encode", view_.heartbeat().age_ns(now_ns)},
       {"record", recorder_.heartbeat().age_ns(now_ns)},
       {"control", control_.heartbeat().age_ns(now_ns)},
       {"page", page_ == nullptr ? -1 : page_->age_ns(now_ns)}}};
  Observation seen;
  seen.now_ns = now_ns;
  seen.pipeline = pipeline;
  seen.fault = fault.c_str();
  seen.outputs = outputs;
  seen.recording = recorder.recording;
  seen.output_fault = recorder.fault.c_str();
  seen.effort = judge_load(seen.pipeline, now_ns);
  seen.effort_reason = ladder_.reason();
  const Judgement& now = supervisor_.judge(seen);
  show(now, now_ns);  // before it is said: who hears of it may ask at once
  if (now.changed) say(now);
  say_recovery(pipeline, fault);
  notify(now, seen.pipeline.frames_per_second, now_ns);
}

void Service::show(const Judgement& now, std::int64_t now_ns) {
  control_.press(panel_.look(now.state, now.alive, now_ns));
  publish(now, now_ns);
}

// Follows heat and speed, and tells the pipeline.
Effort Service::judge_load(const HealthSnapshot& pipeline, std::int64_t now_ns) {
  if (heat_read_ns_ == 0 || now_ns - heat_read_ns_ >= kHeatPeriodNs) {
    heat_ = thermal_.read();
    heat_read_ns_ = now_ns;
  }
  LoadFacts facts;
  facts.now_ns = now_ns;
  facts.throttled = heat_.throttled;
  facts.headroom_celsius = heat_.headroom_celsius;
  facts.inference_ns = pipeline.inference_p50_ns;
  facts.has_small_network = pipeline_.has_small_engine();
  effort_ = ladder_.judge(facts);
  pipeline_.set_effort(effort_);
  return effort_;
}

// Changes at once, figures now and then, pings at half of the watchdog's time-out.
void Service::notify(const Judgement& now, double rate, std::int64_t now_ns) {
  const bool first_ready = now.ready && !ready_said_;
  if (now.changed || first_ready || now_ns - last_line_ns_ >= kStatusLineNs) {
    const std::string line = status_line(now, rate);
    first_ready ? notify_.ready(line) : notify_.status(line);
    ready_said_ = now.ready;
    last_line_ns_ = now_ns;
  }
  const std::int64_t period = notify_.watchdog_ns() / 2;
  if (period == 0 || !now.ready || !now.alive || now_ns - last_ping_ns_ < period) return;
  notify_.ping();
  last_ping_ns_ = now_ns;
  ++pings_;
}

void Service::publish(const Judgement& now, std::int64_t now_ns) {
  ServiceStatus status;
  status.judgement = now;
  status.looked_ns = now_ns;
  status.managed = notify_.listened();
  status.watchdog_ns = notify_.watchdog_ns();
  status.pings = pings_;
  status.effort = effort_;
  status.effort_reason = ladder_.reason();
  status.lowered = ladder_.lowered();
  status.raised = ladder_.raised();
  status.thermal = heat_;
  status.gpio_warnings = panel_.warnings();
  const std::lock_guard lock(mutex_);
  status_ = std::move(status);
}

// Every change once, with its reason.
void Service::say(const Judgement& now) {
  if (gives_depth(now.state) && !announced_) announce_source();
  std::printf("%s%s%s\n", to_string(now.state), now.reason[0] == 0 ? "" : ": ", now.reason);
  std::fflush(stdout);
}

// Every rung of the recovery ladder as it is taken. A step that is repeated for the same reason, as
// once a second while the device is away, is one.
void Service::say_recovery(const HealthSnapshot& pipeline, const std::string& fault) {
  if (pipeline.state == PipelineState::kStreaming) said_rung_.clear();
  for (std::size_t i = 0; i < kRecoveryRungs; ++i) {
    if (pipeline.recovery[i] == said_steps_[i]) continue;
    said_steps_[i] = pipeline.recovery[i];
    const auto rung = static_cast<RecoveryRung>(i);
    std::string line = std::string(to_string(rung)) + ": " + fault;
    if (line == said_rung_) continue;
    std::printf("recovery: %s\n", line.c_str());
    said_rung_ = std::move(line);
  }
  std::fflush(stdout);
}

void Service::announce_source() {
  announced_ = true;
  const Pipeline::Source source = pipeline_.source();
  const EngineStats stats = pipeline_.engine().stats;
  std::printf("source  %s (%s)\n", source.info.uri.c_str(), source.info.description.c_str());
  std::printf("model   %s, %dx%d, %d thread%s, %s\n", stats.model_name.c_str(), stats.width,
              stats.height, stats.threads, stats.threads == 1 ? "" : "s",
              to_string(stats.precision));
  std::printf("licence %s\n", stats.model_licence.c_str());
  if (!stats.memory_locked) {
    std::printf(
        "warning: its weights and activations may be swapped out (raise LimitMEMLOCK= or ulimit "
        "-l)\n");
  }
  if (!huge_pages_) {
    std::printf(
        "warning: no huge pages, inference may be slower (echo madvise "
        ">/sys/kernel/mm/transparent_hugepage/enabled)\n");
  }
}

}  // namespace lcdm
