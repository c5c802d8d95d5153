#include <algorithm>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string_view>
#include <vector>

#include "drivers/mcap_camera.h"
#include "firmware/base/file.h"
#include "model/commands.h"
#include "model/dataset_files.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;

constexpr int kQuality = 92;  // of reduced JPEGs

struct Options {
  std::string recording;
  std::string output;
  std::size_t every = 1;
  int width = 0;
};

// Of the pictures in the pack: as wide as they are, or of `width` columns.
cv::Size packed_size(const CameraModel& camera, int width) {
  if (width == 0 || width >= camera.width) return {camera.width, camera.height};
  return {width, std::max(1, cvRound(static_cast<double>(camera.height) * width / camera.width))};
}

Status write_intrinsics(const fs::path& file, const CameraModel& model) {
  char text[512];
  const int length = std::snprintf(
      text, sizeof(text),
      "{\"width\": %d, \"height\": %d, \"depth_unit_m\": 0.001, \"fx\": %.6g, \"fy\": %.6g, "
      "\"cx\": %.6g, \"cy\": %.6g, \"calibrated\": %s}\n",
      model.width, model.height, static_cast<double>(model.fx), static_cast<double>(model.fy),
      static_cast<double>(model.cx), static_cast<double>(model.cy),
      model.calibrated ? "true" : "false");
  return write_file(file.string(), std::string_view(text, static_cast<std::size_t>(length)));
}

using Bytes = std::vector<std::uint8_t>;

// `jpeg` at `size`; empty where it is not a picture of the camera's `whole`.
Bytes reduced(const Bytes& jpeg, cv::Size whole, cv::Size size) {
  Bytes out;
  const Status done = dataset::guarded("a picture", [&] {
    cv::Mat picture = cv::imdecode(jpeg, cv::IMREAD_COLOR);
    if (picture.size() != whole) return Status::error(StatusCode::kCorrupt, "another size");
    cv::resize(picture, picture, size, 0, 0, cv::INTER_AREA);
    cv::imencode(".jpg", picture, out, {cv::IMWRITE_JPEG_QUALITY, kQuality});
    return Status::ok();
  });
  return done ? out : Bytes();
}

// The recording's JPEGs become rgb/NNNNNN.jpg, untouched or reduced, named as `lcdm infer` names
// their depth.
Status run(const Options& options) {
  McapCamera camera(options.recording, McapCamera::Playback::kOffline);
  LCDM_RETURN_IF_ERROR(camera.configure({}));
  if (camera.model().distorted()) {
    return Status::error(StatusCode::kUnsupported,
                         "%s: its camera's lens distorts, and packs are of pinhole pictures: "
                         "record without camera.calibration for training",
                         options.recording.c_str());
  }
  const fs::path rgb = fs::path(options.output) / "rgb";
  std::error_code error;
  if (fs::exists(rgb, error) && !fs::is_empty(rgb, error)) {
    return Status::error(StatusCode::kUsage,
                         "--output %s holds a pack: another recording's pictures would mix with "
                         "its own; give another folder",
                         options.output.c_str());
  }
  LCDM_RETURN_IF_ERROR(camera.start());
  fs::create_directories(rgb, error);
  if (error) return Status::system(error.value(), "cannot make the folder %s", rgb.c_str());

  const CameraModel model = camera.model();
  const cv::Size size = packed_size(model, options.width);
  std::size_t read = 0;
  std::size_t written = 0;
  std::size_t damaged = 0;
  while (true) {
    const auto frame = camera.dequeue(std::chrono::milliseconds(1000));
    if (frame.code() == StatusCode::kEndOfStream) break;
    if (frame.code() == StatusCode::kCorrupt) {
      ++damaged;
      continue;
    }
    if (!frame) return frame.status();
    if (read++ % options.every == 0) {
      const fs::path file = rgb / (camera.frame_name(frame->view.meta.sequence) + ".jpg");
      Bytes jpeg(frame->view.data, frame->view.data + frame->view.bytes);
      if (size.width != model.width) jpeg = reduced(jpeg, {model.width, model.height}, size);
      if (jpeg.empty()) {
        ++damaged;
      } else {
        LCDM_RETURN_IF_ERROR(write_file(file.string(), std::as_bytes(std::span(jpeg))));
        ++written;
      }
    }
    LCDM_RETURN_IF_ERROR(camera.requeue(frame->index));
  }
  LCDM_RETURN_IF_ERROR(write_intrinsics(fs::path(options.output) / "intrinsics.json",
                                        model.resized(size.width, size.height)));
  std::printf(
      "%zu pictures in %s%s\n", written, options.output.c_str(),
      damaged == 0 ? "" : (", " + std::to_string(damaged) + " damaged ones left out").c_str());
  return Status::ok();
}

}  // namespace

void add_pack(CLI::App& app, Status& status) {
  auto* command = app.add_subcommand(
      "pack", "Makes a training pack of a recording: its pictures and intrinsics");
  auto options = std::make_shared<Options>();
  command->add_option("--recording", options->recording, "MCAP segment, or a folder of them")
      ->required();
  command->add_option("--output", options->output, "Folder of the pack")->required();
  command->add_option("--every", options->every, "Keep every n-th frame")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command
      ->add_option(
          "--width", options->width,
          "Reduce wider pictures to this many pixels, their shape kept; without it they are "
          "the recording's own bytes")
      ->check(CLI::Range(32, 8192));
  command->callback([options, &status] { status = run(*options); });
}

}  // namespace lcdm::model
