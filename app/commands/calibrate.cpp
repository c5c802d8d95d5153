// lcdm calibrate: a checkerboard before the camera, or pictures of one, become a calibration file.
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <ctime>
#include <memory>
#include <optional>
#include <string>

#include "app/board_calibrator.h"
#include "app/commands/commands.h"
#include "app/common_options.h"
#include "app/mjpeg_decoder.h"
#include "app/report.h"
#include "app/source.h"
#include "app/stop_signals.h"
#include "firmware/base/exit_code.h"
#include "firmware/base/os.h"

namespace lcdm {
namespace {

using std::chrono::milliseconds;
using Verdict = BoardCalibrator::Verdict;

constexpr milliseconds kDequeueTimeout{200};
constexpr std::int64_t kSilenceNs = 3'000'000'000;
constexpr int kLiveViews = 15;  // a live camera may as well give more than the fewest

struct CalibrateOptions {
  CommonOptions common;
  std::string source;
  std::string output;
  BoardSize board;
};

// Frames of any format as RGB.
class FrameReader {
 public:
  Status prepare(const FrameFormat& format) {
    format_ = format;
    return prepare_pixels(&decoder_, format).status();
  }
  Status read(const FrameView& frame, RgbPicture& out) {
    if (frame.format != format_) LCDM_RETURN_IF_ERROR(prepare(frame.format));
    const Result<FrameView> pixels = pixels_of(&decoder_, frame);
    if (!pixels) return pixels.status();
    to_rgb(*pixels, out);
    return Status::ok();
  }

 private:
  FrameFormat format_;
  MjpegDecoder decoder_;
};

// Shows frames to the calibrator and tells the person what it thinks of them.
class Session {
 public:
  Session(Camera& camera, const BoardSize& board, bool live)
      : camera_(camera),
        live_(live),
        width_(camera.format().width),
        height_(camera.format().height),
        calibrator_(board, width_, height_) {}

  const BoardCalibrator& calibrator() const { return calibrator_; }

  // Until a signal, the source's end or, live, enough views.
  Status run(const StopSignals& signals) {
    if (live_) std::printf("hold the board before the camera, in many places and tilted\n");
    while (!signals.wait_for(milliseconds(0)) && !enough()) {
      const Result<CapturedFrame> frame = camera_.dequeue(kDequeueTimeout);
      if (frame) {
        heard();
        const Status status = look(frame->view);
        LCDM_RETURN_IF_ERROR(camera_.requeue(frame->index));
        LCDM_RETURN_IF_ERROR(status);
      } else if (frame.code() == StatusCode::kEndOfStream) {
        break;
      } else if (frame.code() == StatusCode::kCorrupt) {
        std::printf("%s\n", frame.status().text());
      } else if (frame.code() == StatusCode::kTimeout) {
        note_silence(frame.status());
      } else {
        return frame.status();
      }
      std::fflush(stdout);
    }
    return Status::ok();
  }

 private:
  bool enough() const {
    return live_ && calibrator_.views() >= kLiveViews &&
           calibrator_.coverage() >= BoardCalibrator::kLeastCoverage;
  }

  void heard() {
    last_frame_ns_ = os::monotonic_ns();
    silence_told_ = false;
  }

  // Once for each silence: who waves a board before a dead camera should know.
  void note_silence(const Status& status) {
    if (silence_told_ || os::monotonic_ns() - last_frame_ns_ < kSilenceNs) return;
    silence_told_ = true;
    std::printf("%s: nothing for 3 s: `lcdm doctor` may know why; Ctrl-C ends\n", status.text());
  }

  Status look(const FrameView& frame) {
    const std::string name = camera_.frame_name(frame.meta.sequence);
    const Status read = reader_.read(frame, picture_);
    if (!read && read.code() != StatusCode::kCorrupt) return read;
    if (!read || picture_.width != width_ || picture_.height != height_) {
      std::printf("%s: %s\n", name.c_str(), read ? "of another size: passed over" : read.text());
      return Status::ok();
    }
    const Verdict verdict = calibrator_.add(picture_);
    if (live_ && verdict == last_ && verdict != Verdict::kTaken) return Status::ok();
    last_ = verdict;
    if (!live_) {
      std::printf("%s: %s\n", name.c_str(), to_string(verdict));
    } else if (verdict == Verdict::kTaken) {
      std::printf("view %d of %d, %.0f %% of the picture covered; now %s, tilted\n",
                  calibrator_.views(), kLiveViews, 100 * calibrator_.coverage(),
                  calibrator_.where_next().c_str());
    } else {
      std::printf("%s\n", to_string(verdict));
    }
    return Status::ok();
  }

  Camera& camera_;
  const bool live_;
  const int width_;
  const int height_;
  BoardCalibrator calibrator_;
  FrameReader reader_;
  RgbPicture picture_;
  std::optional<Verdict> last_;
  std::int64_t last_frame_ns_ = os::monotonic_ns();
  bool silence_told_ = false;
};

std::string utc_now() {
  const std::time_t seconds = (os::monotonic_ns() + os::unix_offset_ns()) / 1'000'000'000;
  std::tm utc{};
  gmtime_r(&seconds, &utc);
  char text[32];
  std::strftime(text, sizeof(text), "%Y-%m-%dT%H:%M:%SZ", &utc);
  return text;
}

void announce(const Calibration& calibration, double coverage, const std::string& file) {
  constexpr double kDegrees = 180 / 3.14159265358979;
  const CameraModel& m = calibration.model;
  const auto field = [](int size, float focal) {
    return 2 * kDegrees * std::atan(size / (2.0 * focal));
  };
  std::printf("%d views, %.0f %% of the picture covered, error %.2f pixels (RMS)\n",
              calibration.views, 100 * coverage, calibration.rms_error);
  std::printf("fx %.1f, fy %.1f, centre %.1f, %.1f: %.1f by %.1f degrees\n",
              static_cast<double>(m.fx), static_cast<double>(m.fy), static_cast<double>(m.cx),
              static_cast<double>(m.cy), field(m.width, m.fx), field(m.height, m.fy));
  std::printf("written to %s: use it as camera.calibration\n", file.c_str());
}

int calibrate(const CalibrateOptions& options) {
  const StopSignals signals;
  Result<Config> config =
      options.common.load(Overrides().add("camera.source", "--source", options.source).take());
  if (!config) return report(config.status());
  if (const Status found = settle_source(*config); !found) return report(found);
  Result<OpenedSource> source = open_source(config->camera.source, Playback::kOffline);
  if (!source) return report(source.status());
  Camera& camera = *source->camera;
  Status status = camera.configure(capture_request(*config));
  if (status) status = camera.start();
  if (!status) return report(status);

  Session session(camera, options.board, source->endless);
  status = session.run(signals);
  camera.stop();
  if (!status) return report(status);
  Result<Calibration> calibration = session.calibrator().solve();
  if (!calibration) return report(calibration.status());
  calibration->camera = camera.info().uri;
  calibration->date = utc_now();
  const std::string file = !options.output.empty()               ? options.output
                           : !config->camera.calibration.empty() ? config->camera.calibration
                                                                 : "calibration.toml";
  if (status = write_calibration(file, *calibration); !status) return report(status);
  announce(*calibration, session.calibrator().coverage(), file);
  return kExitOk;
}

Status parse_board(const std::string& text, BoardSize& board) {
  char rest = 0;
  if (std::sscanf(text.c_str(), "%3dx%3d%c", &board.columns, &board.rows, &rest) == 2 &&
      board.columns >= 3 && board.rows >= 3 && board.columns <= 100 && board.rows <= 100) {
    return Status::ok();
  }
  return Status::error(StatusCode::kUsage,
                       "--board %s: write the corners between its squares, as 9x6, from 3x3",
                       text.c_str());
}

}  // namespace

void add_calibrate_command(CLI::App& program, int& exit_code) {
  auto options = std::make_shared<CalibrateOptions>();
  auto board = std::make_shared<std::string>("9x6");
  CLI::App* command = program.add_subcommand(
      "calibrate", "Intrinsics and lens of a camera from views of a checkerboard, into a file");
  command
      ->add_option("--source", options->source,
                   "A camera, live, or file:FOLDER with pictures it took (default: the configured)")
      ->type_name("URI");
  command
      ->add_option("--board", *board,
                   "Corners between the board's squares: columns x rows (default: 9x6)")
      ->type_name("CxR");
  command
      ->add_option("--output", options->output,
                   "The file (default: camera.calibration, else calibration.toml)")
      ->type_name("FILE");
  options->common.add_to(*command);
  command->callback([options, board, &exit_code] {
    const Status status = parse_board(*board, options->board);
    exit_code = status ? calibrate(*options) : report(status);
  });
}

}  // namespace lcdm
