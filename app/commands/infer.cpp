// lcdm infer: depth of every frame of a source, as files.
#include <array>
#include <chrono>
#include <climits>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <system_error>
#include <unistd.h>
#include <vector>

#include "app/commands/commands.h"
#include "app/common_options.h"
#include "app/depth_colour.h"
#include "app/mjpeg_decoder.h"
#include "app/report.h"
#include "app/rgb_picture.h"
#include "app/source.h"
#include "drivers/codec/codec.h"
#include "firmware/base/exit_code.h"
#include "firmware/base/file.h"
#include "firmware/base/os.h"

namespace lcdm {
namespace {

constexpr std::chrono::milliseconds kDequeueTimeout{1000};
constexpr int kMostTimeouts = 5;

struct InferOptions {
  CommonOptions common;
  std::string source;
  std::string output;
  int frames = 0;  // 0: to the source's end
  bool as_float = false;
  bool as_colour = false;
};

// The engine for frames of one format, made again when the format changes (a folder of images).
class FrameEngine {
 public:
  FrameEngine(const ModelFile& model, const EngineOptions& options)
      : model_(model), options_(options) {}

  Status run(const FrameView& frame, const CameraModel& camera) {
    if (!engine_ || frame.format != format_) LCDM_RETURN_IF_ERROR(prepare(frame.format, camera));
    const Result<FrameView> pixels = pixels_of(&decoder_, frame);
    if (!pixels) return pixels.status();
    const CameraModel& depth = engine_->depth_camera();
    return engine_->run(*pixels, {depth.width, depth.height, millimetres_.data(), metres_.data()});
  }

  // Of the last run.
  const CameraModel& camera() const { return engine_->depth_camera(); }
  ScaleKind scale() const { return engine_->scale(); }
  const std::vector<std::uint16_t>& millimetres() const { return millimetres_; }
  const std::vector<float>& metres() const { return metres_; }

 private:
  Status prepare(const FrameFormat& format, const CameraModel& camera) {
    const Result<FrameFormat> pixels = prepare_pixels(&decoder_, format);
    if (!pixels) return pixels.status();
    engine_.reset();
    auto made = Engine::prepare(model_, options_, *pixels, camera);
    if (!made) return made.status();
    engine_ = std::move(*made);
    format_ = format;
    const CameraModel& depth = engine_->depth_camera();
    const auto count =
        static_cast<std::size_t>(depth.width) * static_cast<std::size_t>(depth.height);
    millimetres_.resize(count);
    metres_.resize(count);
    return Status::ok();
  }

  const ModelFile& model_;
  const EngineOptions options_;
  MjpegDecoder decoder_;
  std::unique_ptr<Engine> engine_;
  FrameFormat format_;
  std::vector<std::uint16_t> millimetres_;  // [height * width]
  std::vector<float> metres_;               // the same
};

// Reads frames, writes files, and keeps the person informed.
class Inference {
 public:
  Inference(const InferOptions& options, const ModelFile& model, const EngineOptions& engine)
      : options_(options), engine_(model, engine) {}

  int run(Camera& camera) {
    const std::int64_t begin_ns = os::monotonic_ns();
    const Status status = read_all(camera);
    const double seconds = static_cast<double>(os::monotonic_ns() - begin_ns) * 1e-9;
    if (isatty(STDERR_FILENO) != 0) std::fputc('\r', stderr);
    std::fprintf(stderr, "%d frame%s in %.1f s, %d broken, in %s\n", written_,
                 written_ == 1 ? "" : "s", seconds, broken_, options_.output.c_str());
    if (!status) return report(status);
    return broken_ > 0 || written_ == 0 ? kExitFailure : kExitOk;
  }

 private:
  Status read_all(Camera& camera) {
    int timeouts = 0;
    while (options_.frames == 0 || written_ < options_.frames) {
      const Result<CapturedFrame> frame = camera.dequeue(kDequeueTimeout);
      if (frame) {
        timeouts = 0;
        const Status status = write(camera, frame->view);
        LCDM_RETURN_IF_ERROR(camera.requeue(frame->index));
        // A JPEG of a kind that is not decoded is as good as a broken one.
        const bool unreadable = status.code() == StatusCode::kUnsupported;
        LCDM_RETURN_IF_ERROR(unreadable ? count_broken(status) : pass_over(status));
      } else if (frame.code() == StatusCode::kEndOfStream) {
        return Status::ok();
      } else if (frame.code() != StatusCode::kTimeout || ++timeouts == kMostTimeouts) {
        LCDM_RETURN_IF_ERROR(pass_over(frame.status()));
      }
    }
    return Status::ok();
  }

  // A broken frame is named and counted; any other error ends the run.
  Status pass_over(const Status& status) {
    return status.code() == StatusCode::kCorrupt ? count_broken(status) : status;
  }

  Status count_broken(const Status& status) {
    std::fprintf(stderr, "lcdm: %s\n", status.text());
    ++broken_;
    return Status::ok();
  }

  Status write(const Camera& camera, const FrameView& frame) {
    LCDM_RETURN_IF_ERROR(engine_.run(frame, camera.model()));
    const std::string path = options_.output + "/" + camera.frame_name(frame.meta.sequence);
    const int width = engine_.camera().width;
    const int height = engine_.camera().height;
    const std::array<ImageText, 3> texts = {{{"scale", to_string(engine_.scale())},
                                             {"unit", "millimetre"},
                                             {"source", options_.source}}};
    LCDM_RETURN_IF_ERROR(
        write_depth_png(path + ".png", engine_.millimetres(), width, height, texts));
    if (options_.as_float) {
      const std::array<ImageText, 3> float_texts = {{texts[0], {"unit", "metre"}, texts[2]}};
      LCDM_RETURN_IF_ERROR(
          write_float_tiff(path + ".tiff", engine_.metres(), width, height, float_texts));
    }
    if (options_.as_colour) LCDM_RETURN_IF_ERROR(write_colour(path + ".jpg", width, height));
    ++written_;
    if (isatty(STDERR_FILENO) != 0) std::fprintf(stderr, "\r%d frames", written_);
    return Status::ok();
  }

  // Each picture has colours of its own range.
  Status write_colour(const std::string& path, int width, int height) {
    if (const auto range = range_of(engine_.millimetres())) colours_.set_range(*range);
    picture_.resize(width, height);
    colours_.paint(engine_.millimetres(), picture_.pixels);
    const Result<std::span<const std::byte>> jpeg = jpeg_.encode(picture_.view());
    return jpeg ? write_file(path, *jpeg) : jpeg.status();
  }

  const InferOptions& options_;
  FrameEngine engine_;
  DepthColour colours_;
  JpegWriter jpeg_{kKeptQuality};
  RgbPicture picture_;
  int written_ = 0;
  int broken_ = 0;
};

Status make_directory(const std::string& path) {
  std::error_code error;
  std::filesystem::create_directories(path, error);
  if (!error && std::filesystem::is_directory(path, error) && access(path.c_str(), W_OK) == 0) {
    return Status::ok();
  }
  return Status::error(StatusCode::kIoError,
                       "--output %s: cannot write there: give a folder that can be made or written",
                       path.c_str());
}

// The files of a folder of images would be overwritten by their own depth.
Status check_not_the_source(const InferOptions& options) {
  const std::optional<std::string> path = after_scheme(options.source, "file:");
  if (!path) return Status::ok();
  std::filesystem::path source = *path;
  std::error_code error;
  if (!std::filesystem::is_directory(source, error)) source = source.parent_path();
  if (source.empty()) source = ".";
  if (!std::filesystem::equivalent(source, options.output, error)) return Status::ok();
  return Status::error(StatusCode::kUsage,
                       "--output %s is the source's own folder: its files would be overwritten; "
                       "give another",
                       options.output.c_str());
}

int infer(const InferOptions& options) {
  const Result<Config> config = options.common.load();
  if (!config) return report(config.status());
  if (const Status status = check_not_the_source(options); !status) return report(status);
  const Result<ModelFile> model = load_model(*config);
  if (!model) return report(model.status());
  Result<OpenedSource> source = open_source(*config, options.source, Playback::kOffline);
  if (!source) return report(source.status());
  Camera& camera = *source->camera;
  if (const Status status = camera.configure(capture_request(*config)); !status) {
    return report(status);
  }
  if (const Status status = make_directory(options.output); !status) return report(status);
  if (const Status status = camera.start(); !status) return report(status);
  const int exit_code = Inference(options, *model, engine_options(*config)).run(camera);
  camera.stop();
  return exit_code;
}

}  // namespace

void add_infer_command(CLI::App& program, int& exit_code) {
  auto options = std::make_shared<InferOptions>();
  CLI::App* command = program.add_subcommand(
      "infer", "Depth of every frame of a source: NAME.png, 16-bit millimetres, in a folder");
  command
      ->add_option("--source", options->source,
                   "file:PATH (video, image, folder), mcap:PATH, scene: or v4l2:/dev/...")
      ->type_name("URI")
      ->required();
  command->add_option("--output", options->output, "Folder for the files; made when missing")
      ->type_name("DIR")
      ->required();
  command
      ->add_option("--frames", options->frames,
                   "End after N frames (default: the source's end; scene: has none)")
      ->check(CLI::Range(1, INT_MAX));
  command->add_flag("--float", options->as_float, "Also NAME.tiff: 32-bit float metres");
  command->add_flag("--colour", options->as_colour, "Also NAME.jpg: colours, near is warm");
  options->common.add_to(*command);
  options->common.add_model_to(*command);
  command->callback([options, &exit_code] { exit_code = infer(*options); });
}

}  // namespace lcdm
