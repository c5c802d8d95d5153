// The supervising loop of `lcdm run`: looks at everything several times a second, decides the
// device's state, and tells it to systemd and to people.
#pragma once

#include <array>
#include <cstdint>
#include <mutex>
#include <string>
#include <vector>

#include "app/config.h"
#include "app/control.h"
#include "app/front_panel.h"
#include "app/live_view.h"
#include "app/recorder.h"
#include "app/stop_signals.h"
#include "drivers/service_notify.h"
#include "drivers/thermal.h"
#include "firmware/health/degrade_ladder.h"
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
  Effort effort = Effort::kFull;
  std::string effort_reason;  // empty at full effort
  std::uint64_t lowered = 0;  // times the effort was
  std::uint64_t raised = 0;
  ThermalReading thermal;
  std::vector<std::string> gpio_warnings;  // why lines are missing
};

// Whether depth comes in this state.
bool gives_depth(DeviceState state);

// Threads: start and run belong to main; status is for any thread.
class Service {
 public:
  // The first three are borrowed and must outlive the service. `sysfs`: where it is mounted.
  Service(Pipeline& pipeline, const LiveView& view, Recorder& recorder, const Config& config,
          const std::string& sysfs = "/sys");

  // The heart of who asks whether the page answers; borrowed. Before start.
  void watch_page(const Heartbeat& page) { page_ = &page; }

  // Starts the pipeline, which takes a slow board seconds, and shows meanwhile that the device
  // boots. After a signal `run` ends at once; a start that goes on for a second more ends the
  // process.
  Status start(const StopSignals& signals);
  // Until a signal comes, the source ends or its recovery does; the pipeline runs meanwhile.
  // kIoError: only a new process may bring the camera back.
  Status run(const StopSignals& signals);
  // Ends the pipeline. A driver that holds it for longer than a second ends the process with
  // `exit_code`: whoever calls has nothing else to lose.
  void end(int exit_code);

  ServiceStatus status() const;

 private:
  void look();
  void show(const Judgement& now, std::int64_t now_ns);
  Effort judge_load(const HealthSnapshot& pipeline, std::int64_t now_ns);
  void say(const Judgement& now);
  void say_recovery(const HealthSnapshot& pipeline, const std::string& fault);
  void notify(const Judgement& now, double rate, std::int64_t now_ns);
  void announce_source();
  void publish(const Judgement& now, std::int64_t now_ns);

  Pipeline& pipeline_;
  const LiveView& view_;
  const Recorder& recorder_;
  const ServiceNotify notify_;
  const Thermal thermal_;
  const bool huge_pages_;  // the kernel gives them
  ButtonControl control_;
  const Heartbeat* page_ = nullptr;

  FrontPanel panel_;  // from here on: main
  Supervisor supervisor_;
  DegradeLadder ladder_;
  ThermalReading heat_;
  Effort effort_ = Effort::kFull;
  std::int64_t heat_read_ns_ = 0;
  std::array<std::uint64_t, kRecoveryRungs> said_steps_{};
  std::string said_rung_;  // the newest and why, since depth last came
  bool stopped_ = false;   // by a signal during the start
  bool announced_ = false;
  bool ready_said_ = false;
  std::int64_t last_ping_ns_ = 0;
  std::int64_t last_line_ns_ = 0;
  std::uint64_t pings_ = 0;

  mutable std::mutex mutex_;  // guards what follows
  ServiceStatus status_;
};

}  // namespace lcdm
