// The supervising loop of `lcdm run`: looks at everything several times a second, decides the
// device's state, and tells it to systemd and to people.
#pragma once

#include <cstdint>
#include <mutex>

#include "app/live_view.h"
#include "app/recorder.h"
#include "app/stop_signals.h"
#include "drivers/service_notify.h"
#include "firmware/health/supervisor.h"
#include "firmware/pipeline/pipeline.h"

namespace lcdm {

// What the last look found.
struct ServiceStatus {
  Judgement judgement;
  std::int64_t looked_ns = 0;    // CLOCK_MONOTONIC; old: main hangs
  bool managed = false;          // systemd listens
  std::int64_t watchdog_ns = 0;  // its time-out; 0: none
  std::uint64_t pings = 0;       // sent so far
};

// Whether depth comes in this state.
bool gives_depth(DeviceState state);

// Threads: run belongs to main; status is for any thread.
class Service {
 public:
  // All three are borrowed and must outlive the service.
  Service(Pipeline& pipeline, const LiveView& view, const Recorder& recorder);

  // Until a signal comes or the source ends; the pipeline runs meanwhile.
  void run(const StopSignals& signals);

  ServiceStatus status() const;

 private:
  void look();
  void say(const Judgement& now);
  void ping(const Judgement& now, std::int64_t now_ns);
  void announce_source();

  Pipeline& pipeline_;
  const LiveView& view_;
  const Recorder& recorder_;
  const ServiceNotify notify_;

  Supervisor supervisor_;  // from here on: main
  bool announced_ = false;
  bool ready_said_ = false;
  std::int64_t last_ping_ns_ = 0;
  std::int64_t last_line_ns_ = 0;
  std::uint64_t pings_ = 0;

  mutable std::mutex mutex_;  // guards what follows
  ServiceStatus status_;
};

}  // namespace lcdm
