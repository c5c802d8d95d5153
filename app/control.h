// What people may change while the device runs: recording, and powering it off.
#pragma once

#include <atomic>
#include <semaphore>
#include <thread>

#include "app/recorder.h"
#include "firmware/base/status.h"
#include "firmware/health/heartbeat.h"
#include "firmware/health/indicator.h"
#include "firmware/pipeline/pipeline.h"

namespace lcdm {

// Begins a recording of what the pipeline's source gives; harmless while one is under way. Waits
// for the disk.
Status start_recording(const Pipeline& pipeline, Recorder& recorder);

// Asks the system to power the machine off: writes the file `poweroff` into the folder that systemd
// gave us (RuntimeDirectory=), which lcdm-poweroff.path watches. The service itself has no right to
// power anything off. kUnsupported where there is no such folder.
Status request_power_off();

// Does what the button asks; recordings begin and end on a thread of its own, `control`: main must
// not wait for a disk.
class ButtonControl {
 public:
  // Both are borrowed and must outlive it.
  ButtonControl(const Pipeline& pipeline, Recorder& recorder);
  ~ButtonControl();
  ButtonControl(const ButtonControl&) = delete;
  ButtonControl& operator=(const ButtonControl&) = delete;

  // Never waits for a disk. Short: recording begins or ends; two while another is in work are one.
  // Long: power off is asked for at once, and the stop that follows ends a recording.
  void press(Press press);

  // Of the thread `control`: rests while nothing is pressed.
  const Heartbeat& heartbeat() const { return heartbeat_; }

 private:
  void run();
  Status toggle_recording();

  const Pipeline& pipeline_;
  Recorder& recorder_;
  std::atomic<bool> toggle_wanted_{false};
  std::atomic<bool> stopping_{false};
  std::counting_semaphore<> work_{0};
  Heartbeat heartbeat_;
  std::thread thread_;
};

}  // namespace lcdm
