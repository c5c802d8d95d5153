#include "drivers/replay/camera.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <filesystem>
#include <map>
#include <opencv2/core.hpp>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/videoio.hpp>
#include <thread>
#include <vector>

#include "drivers/replay/files.h"
#include "firmware/base/os.h"

namespace lcdm {
namespace {

namespace fs = std::filesystem;
constexpr int kBuffers = 6;

// Runs OpenCV code, which reports errors by throwing; false when it did.
template <typename Action>
bool without_throwing(Action action) {
  try {
    action();
    return true;
  } catch (const std::exception&) {
    return false;
  }
}

}  // namespace

// ---- reading ------------------------------------------------------------------------------------

class ReplayCamera::Reader {
 public:
  static Result<std::unique_ptr<Reader>> open(const std::string& path) {
    cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
    std::error_code error;
    auto reader = std::unique_ptr<Reader>(new Reader(path));
    if (fs::is_directory(path, error)) {
      auto images = replay::list_images(path);
      if (!images) return images.status();
      reader->images_ = std::move(*images);
      for (const std::string& image : reader->images_) ++reader->stems_[fs::path(image).stem()];
      return reader;
    }
    if (!fs::exists(path, error)) {
      return Status::error(StatusCode::kNotFound,
                           "file:%s: no such file: give a video, an image or a folder of images",
                           path.c_str());
    }
    if (replay::is_image_name(path)) {
      reader->images_ = {path};
      return reader;
    }
    LCDM_RETURN_IF_ERROR(reader->rewind());
    return reader;
  }

  bool is_video() const { return images_.empty(); }
  std::size_t image_count() const { return images_.size(); }
  // The image's name without its folder and, where no other image of the folder has the same
  // name before it, without its extension.
  std::string name(std::size_t index) const {
    const fs::path path = images_[index];
    const auto stem = stems_.find(path.stem());
    const bool shared = stem != stems_.end() && stem->second > 1;
    return (shared ? path.filename() : path.stem()).string();
  }

  // The video's own rate; 0 where it has none, and for images.
  float rate() {
    double rate = 0;
    if (is_video()) without_throwing([&] { rate = video_.get(cv::CAP_PROP_FPS); });
    return rate > 0.1 && rate < 1000 ? static_cast<float>(rate) : 0;
  }

  Status rewind() {
    next_ = 0;
    if (!is_video()) return Status::ok();
    // By name: asked for any back end, OpenCV would also start GStreamer and look for cameras.
    bool opened = false;
    without_throwing([&] { opened = video_.open(path_, cv::CAP_FFMPEG); });
    if (opened) return Status::ok();
    return Status::error(StatusCode::kUnsupported,
                         "file:%s: not a video that OpenCV can read, nor an image by its name",
                         path_.c_str());
  }

  // The next picture as 8-bit BGR. kEndOfStream behind the last, kCorrupt for one that is lost.
  Status read(cv::Mat& out) {
    if (!is_video()) return read_image(out);
    bool read = false;
    without_throwing([&] { read = video_.read(out) && out.type() == CV_8UC3; });
    if (read) {
      ++next_;
      return Status::ok();
    }
    if (next_ > 0) return Status::error(StatusCode::kEndOfStream, "file:%s: end", path_.c_str());
    return Status::error(StatusCode::kCorrupt, "file:%s: no frame in this video can be read",
                         path_.c_str());
  }

 private:
  explicit Reader(std::string path) : path_(std::move(path)) {}

  Status read_image(cv::Mat& out) {
    if (next_ == images_.size()) {
      return Status::error(StatusCode::kEndOfStream, "file:%s: end", path_.c_str());
    }
    const std::string& name = images_[next_++];
    const auto bytes = replay::read_image_file(name);
    if (!bytes) return bytes.status();
    out.release();
    without_throwing([&] { cv::imdecode(*bytes, cv::IMREAD_COLOR, &out); });
    if (!out.empty()) return Status::ok();
    return Status::error(StatusCode::kCorrupt, "file:%s: unreadable image: damaged, or no image",
                         name.c_str());
  }

  const std::string path_;
  std::vector<std::string> images_;   // empty: a video
  std::map<std::string, int> stems_;  // how many images of the folder have each
  cv::VideoCapture video_;
  std::size_t next_ = 0;
};

struct ReplayCamera::Buffers {
  struct Buffer {
    cv::Mat image;
    bool free = true;
  };
  std::array<Buffer, kBuffers> all;
};

// ---- the camera ---------------------------------------------------------------------------------

ReplayCamera::ReplayCamera(std::string path, Playback playback)
    : path_(std::move(path)), playback_(playback), buffers_(std::make_unique<Buffers>()) {}

ReplayCamera::~ReplayCamera() = default;

Status ReplayCamera::configure(const CaptureRequest& request) {
  stop();
  reader_.reset();
  auto reader = Reader::open(path_);
  if (!reader) return reader.status();
  std::error_code error;
  const std::string folder =
      fs::is_directory(path_, error) ? path_ : fs::absolute(path_, error).parent_path().string();
  auto calibration = replay::find_intrinsics(folder);
  if (!calibration) return calibration.status();
  calibration_ = *calibration;
  field_of_view_ = request.assumed_field_of_view;
  const float rate = (*reader)->rate();
  frames_per_second_ = rate > 0 ? rate : std::clamp(request.frames_per_second, 0.01F, 1000.0F);
  reader_ = std::move(*reader);
  const Status status = read_first_frame();
  if (!status) reader_.reset();
  return status;
}

// Learns the format from the first picture that can be read.
Status ReplayCamera::read_first_frame() {
  cv::Mat image;
  Status first = reader_->read(image);
  for (std::size_t i = 1; !first && i < reader_->image_count(); ++i) {
    if (reader_->read(image)) first = Status::ok();
  }
  LCDM_RETURN_IF_ERROR(first);
  format_ = {PixelFormat::kBgr24, image.cols, image.rows,
             packed_stride(PixelFormat::kBgr24, image.cols)};
  model_ = model_for(image.cols, image.rows);
  return Status::ok();
}

// The calibration for pictures of this size. Of another shape they show another cut of the view,
// about which the file says nothing.
CameraModel ReplayCamera::model_for(int width, int height) const {
  if (calibration_.width > 0 && calibration_.has_shape(width, height)) {
    return calibration_.resized(width, height);
  }
  return CameraModel::from_field_of_view(width, height, field_of_view_);
}

CameraInfo ReplayCamera::info() const {
  char text[128] = "";
  if (reader_ != nullptr && reader_->is_video()) {
    std::snprintf(text, sizeof(text), "video, %dx%d at %.4g frames/s", format_.width,
                  format_.height, static_cast<double>(frames_per_second_));
  } else if (reader_ != nullptr) {
    std::snprintf(text, sizeof(text), "%zu image%s, %dx%d at %.4g frames/s", reader_->image_count(),
                  reader_->image_count() == 1 ? "" : "s", format_.width, format_.height,
                  static_cast<double>(frames_per_second_));
  }
  return {"file:" + path_, text, frames_per_second_};
}

int ReplayCamera::buffer_count() const { return kBuffers; }

std::string ReplayCamera::frame_name(std::uint64_t sequence) const {
  if (reader_ == nullptr || reader_->is_video()) return Camera::frame_name(sequence);
  return reader_->name(sequence % reader_->image_count());
}

Status ReplayCamera::start() {
  if (reader_ == nullptr) {
    return Status::error(StatusCode::kInvalidInput, "file: start before configure");
  }
  LCDM_RETURN_IF_ERROR(reader_->rewind());
  for (auto& buffer : buffers_->all) buffer.free = true;
  streaming_ = true;
  sequence_ = 0;
  due_ns_ = os::monotonic_ns();
  return Status::ok();
}

void ReplayCamera::stop() { streaming_ = false; }

Result<CapturedFrame> ReplayCamera::dequeue(std::chrono::milliseconds timeout) {
  if (!streaming_) return Status::error(StatusCode::kInvalidInput, "file: dequeue before start");
  auto& all = buffers_->all;
  const auto buffer =
      std::find_if(all.begin(), all.end(), [](const auto& candidate) { return candidate.free; });
  if (!wait_for_turn(buffer != all.end(), timeout)) {
    return Status::error(StatusCode::kTimeout, "file: no frame due or no free buffer");
  }

  cv::Mat& image = buffer->image;
  const Status status = read_next(image);
  if (status.code() == StatusCode::kEndOfStream) return status;
  const std::uint64_t sequence = sequence_++;
  const std::int64_t stamp = take_stamp();
  LCDM_RETURN_IF_ERROR(status);
  if (!live()) {
    model_ = model_for(image.cols, image.rows);
  } else if (!fit(image)) {
    return Status::error(StatusCode::kCorrupt, "file:%s: cannot resize frame %llu", path_.c_str(),
                         static_cast<unsigned long long>(sequence));
  }

  buffer->free = false;
  CapturedFrame frame;
  frame.index = static_cast<int>(buffer - all.begin());
  frame.view.format = {PixelFormat::kBgr24, image.cols, image.rows, static_cast<int>(image.step)};
  frame.view.meta = {sequence, stamp, stamp + os::unix_offset_ns()};
  frame.view.data = image.data;
  frame.view.bytes = image.step * static_cast<std::size_t>(image.rows);
  return frame;
}

// Sleeps until the next frame is due or, where none can be had in time, until `timeout` is over.
bool ReplayCamera::wait_for_turn(bool has_buffer, std::chrono::milliseconds timeout) const {
  const std::int64_t deadline =
      os::monotonic_ns() + std::chrono::duration_cast<std::chrono::nanoseconds>(timeout).count();
  const bool in_time = has_buffer && (!live() || due_ns_ <= deadline);
  if (live() || !in_time) {
    const std::int64_t until = in_time ? due_ns_ : deadline;
    std::this_thread::sleep_for(std::chrono::nanoseconds(until - os::monotonic_ns()));
  }
  return in_time;
}

// Live, the first follows the last.
Status ReplayCamera::read_next(cv::Mat& image) {
  const Status status = reader_->read(image);
  if (!live() || status.code() != StatusCode::kEndOfStream) return status;
  LCDM_RETURN_IF_ERROR(reader_->rewind());
  return reader_->read(image);
}

// Of the frame just read. Offline nobody waits: the stamps alone are a period apart.
std::int64_t ReplayCamera::take_stamp() {
  const auto period = static_cast<std::int64_t>(1e9 / static_cast<double>(frames_per_second_));
  const std::int64_t stamp = live() ? os::monotonic_ns() : due_ns_;
  due_ns_ = live() ? std::max(due_ns_ + period, stamp) : due_ns_ + period;
  return stamp;
}

// Resized to the format's size; false where OpenCV cannot.
bool ReplayCamera::fit(cv::Mat& image) const {
  if (image.cols == format_.width && image.rows == format_.height) return true;
  return without_throwing([&] {
    cv::Mat resized;
    cv::resize(image, resized, {format_.width, format_.height}, 0, 0, cv::INTER_AREA);
    image = resized;
  });
}

Status ReplayCamera::requeue(int index) {
  auto& all = buffers_->all;
  if (index < 0 || index >= kBuffers || all[static_cast<std::size_t>(index)].free) {
    return Status::error(StatusCode::kInvalidInput, "file: buffer %d is not lent", index);
  }
  all[static_cast<std::size_t>(index)].free = true;
  return Status::ok();
}

}  // namespace lcdm
