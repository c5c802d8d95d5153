#include "app/control.h"

#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <fcntl.h>
#include <string>
#include <unistd.h>

#include "firmware/base/os.h"

namespace lcdm {
namespace {

void tell(const Status& status) {
  if (!status) std::fprintf(stderr, "lcdm: button: %s\n", status.text());
}

}  // namespace

Status start_recording(const Pipeline& pipeline, Recorder& recorder) {
  const Pipeline::Source source = pipeline.source();
  if (source.format.width == 0) {
    return Status::error(StatusCode::kUnavailable,
                         "recording: there is no camera yet (%s): wait until it is there",
                         source.info.uri.c_str());
  }
  return recorder.start(source.info.uri, source.format, source.model);
}

Status request_power_off() {
  const char* folder =
      std::getenv("RUNTIME_DIRECTORY");  // NOLINT(concurrency-mt-unsafe): read only
  if (folder == nullptr || folder[0] == 0) {
    return Status::error(StatusCode::kUnsupported,
                         "power off: nobody would hear (not run by lcdm.service): power the "
                         "machine off by hand");
  }
  const std::string file = std::string(folder) + "/poweroff";
  const int descriptor = open(file.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0640);
  if (descriptor < 0) return Status::system(errno, "power off: cannot create %s", file.c_str());
  close(descriptor);
  return Status::ok();
}

ButtonControl::ButtonControl(const Pipeline& pipeline, Recorder& recorder)
    : pipeline_(pipeline), recorder_(recorder), thread_([this] { run(); }) {}

ButtonControl::~ButtonControl() {
  stopping_ = true;
  work_.release();
  thread_.join();
}

void ButtonControl::press(Press press) {
  switch (press) {
    case Press::kNone:
      return;
    case Press::kShort:
      toggle_wanted_ = true;
      work_.release();
      return;
    case Press::kLong:  // here, behind no disk: the folder is in memory
      tell(request_power_off());
      return;
  }
}

void ButtonControl::run() {
  os::set_thread_name("control");
  while (true) {
    work_.acquire();
    if (stopping_) return;
    heartbeat_.beat(os::monotonic_ns());
    if (toggle_wanted_.exchange(false)) tell(toggle_recording());
    heartbeat_.rest();
  }
}

Status ButtonControl::toggle_recording() {
  if (!recorder_.status().recording) return start_recording(pipeline_, recorder_);
  recorder_.stop();
  return Status::ok();
}

}  // namespace lcdm
