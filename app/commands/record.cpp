// lcdm record: frames of a source into MCAP segments, without depth.
#include <chrono>
#include <cstdio>
#include <memory>
#include <string>

#include "app/commands/commands.h"
#include "app/common_options.h"
#include "app/recorder.h"
#include "app/report.h"
#include "app/source.h"
#include "app/stop_signals.h"
#include "firmware/base/exit_code.h"
#include "firmware/base/os.h"

namespace lcdm {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kDequeueTimeout{200};
constexpr std::int64_t kSilenceNs = 3'000'000'000;
constexpr double kMostSeconds = 1e9;  // 31 years

struct RecordOptions {
  CommonOptions common;
  std::string source;
  std::string output;
  double seconds = 0;  // 0: until a signal or the end of the source
};

Result<Config> load(const RecordOptions& options) {
  return options.common.load(Overrides()
                                 .add("camera.source", "--source", options.source)
                                 .add("record.directory", "--output", options.output)
                                 .take());
}

// A frame of a file waits for its turn; one of a camera is lost when the disk is too slow. False
// when a signal came while it waited.
bool take(Recorder& recorder, const FrameView& frame, bool live, const StopSignals& signals) {
  while (!live && recorder.full()) {
    if (signals.wait_for(milliseconds(1))) return false;
  }
  recorder.push_or_drop(frame);
  return true;
}

// Until a signal, the time is over, the source ends or fails, or the recording does. `broken`
// frames are counted; those of files are named.
Status record_frames(Camera& camera, Recorder& recorder, bool live, double seconds,
                     const StopSignals& signals, int& broken) {
  const std::int64_t end =
      seconds > 0 ? os::monotonic_ns() + static_cast<std::int64_t>(seconds * 1e9) : INT64_MAX;
  std::int64_t last_ns = os::monotonic_ns();
  bool told = false;
  while (os::monotonic_ns() < end && !signals.wait_for(milliseconds(0))) {
    const auto frame = camera.dequeue(kDequeueTimeout);
    if (!told && !frame && os::monotonic_ns() - last_ns > kSilenceNs) {
      std::fprintf(stderr, "lcdm: no picture for 3 s: is another program using the camera?\n");
      told = true;
    }
    if (frame) {
      last_ns = os::monotonic_ns();
      const bool go_on = take(recorder, frame->view, live, signals);
      LCDM_RETURN_IF_ERROR(camera.requeue(frame->index));
      if (!go_on) break;
    } else if (frame.code() == StatusCode::kEndOfStream) {
      break;
    } else if (frame.code() == StatusCode::kCorrupt) {
      ++broken;
      if (!live) std::fprintf(stderr, "lcdm: %s\n", frame.status().text());
    } else if (frame.code() != StatusCode::kTimeout) {
      return frame.status();
    }
    const RecorderStatus now = recorder.status();
    if (!now.recording) return Status::error(StatusCode::kIoError, "%s", now.fault.c_str());
  }
  return Status::ok();
}

int record(const RecordOptions& options) {
  const StopSignals signals;
  Result<Config> config = load(options);
  if (!config) return report(config.status());
  if (const Status found = settle_source(*config); !found) return report(found);
  Result<OpenedSource> source = open_source(*config, config->camera.source, Playback::kOffline);
  if (!source) return report(source.status());
  Camera& camera = *source->camera;
  if (const Status status = camera.configure(capture_request(*config)); !status) {
    return report(status);
  }

  int broken = 0;
  Recorder recorder(recorder_options(*config));
  Status status = camera.start();  // first: one that cannot leaves no empty file behind
  if (status) status = recorder.start(camera.info().uri, camera.format(), camera.model());
  if (status) {
    std::printf("source  %s\nfile    %s\n", camera.info().description.c_str(),
                recorder.status().file.c_str());
    std::fflush(stdout);
    status = record_frames(camera, recorder, source->endless, options.seconds, signals, broken);
  }
  camera.stop();
  recorder.stop();
  const RecorderStatus done = recorder.status();
  if (status && !done.fault.empty()) {
    status = Status::error(StatusCode::kIoError, "%s", done.fault.c_str());
  }
  if (status && done.frames == 0) {
    status = Status::error(StatusCode::kTimeout, "%s: not one frame came: nothing is recorded",
                           camera.info().uri.c_str());
  }
  if (!status) return report(status);
  std::printf("%llu frame%s, %.1f MB", static_cast<unsigned long long>(done.frames),
              done.frames == 1 ? "" : "s", static_cast<double>(done.bytes) * 1e-6);
  if (done.dropped > 0)
    std::printf(", %llu dropped", static_cast<unsigned long long>(done.dropped));
  if (broken > 0) std::printf(", %d broken", broken);
  std::puts("");
  return kExitOk;
}

}  // namespace

void add_record_command(CLI::App& program, int& exit_code) {
  auto options = std::make_shared<RecordOptions>();
  CLI::App* command = program.add_subcommand(
      "record", "Frames of a source with stamps and calibration into MCAP segments");
  command->add_option("--source", options->source, "As for run; files are recorded frame by frame")
      ->type_name("URI");
  command
      ->add_option("--output", options->output,
                   "Folder of the segments (default: record.directory)")
      ->type_name("DIR");
  command
      ->add_option("--seconds", options->seconds,
                   "How long (default: until Ctrl-C or the end of the source)")
      ->check(CLI::Range(1e-3, kMostSeconds));
  options->common.add_to(*command);
  command->callback([options, &exit_code] { exit_code = record(*options); });
}

}  // namespace lcdm
