#include "drivers/mcap_camera.h"

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <system_error>
#include <thread>

#include "drivers/codec/codec.h"
#include "firmware/base/folder.h"
#include "firmware/base/os.h"

namespace lcdm {
namespace {

namespace fs = std::filesystem;
constexpr std::size_t kMaxJpeg = 16U << 20;
constexpr int kMaxSide = 8192;
// Live playback does not sit out longer pauses, nor a clock that was set back. The pipeline would
// take them for a lost signal (PipelineOptions::no_signal_after) and begin anew, never to get past.
constexpr std::int64_t kLongestPauseNs = 1'000'000'000;
// Nor does it play faster than any camera, whatever the stamps say: one frame alone would be played
// over and over.
constexpr std::int64_t kShortestStepNs = 5'000'000;

Result<std::vector<std::string>> find_segments(const std::string& path) {
  std::error_code error;
  std::vector<std::string> segments;
  if (fs::is_directory(path, error)) {
    const auto files = list_folder(path);
    if (!files) return files.status();
    for (const fs::path& file : *files) {
      if (file.extension() == ".mcap") segments.push_back(file.string());
    }
  } else if (fs::exists(path, error)) {
    segments.push_back(path);
  }
  if (segments.empty()) {
    return Status::error(StatusCode::kNotFound,
                         "mcap:%s: no such recording: give an .mcap file or a folder of them",
                         path.c_str());
  }
  return segments;
}

}  // namespace

McapCamera::McapCamera(std::string path, Playback playback)
    : path_(std::move(path)), playback_(playback) {}

Status McapCamera::configure(const CaptureRequest& request) {
  auto segments = find_segments(path_);
  if (!segments) return segments.status();
  segments_ = std::move(*segments);
  topic_.clear();
  calibrations_.clear();
  LCDM_RETURN_IF_ERROR(start());
  const Status status = inspect_first_frame(request.assumed_field_of_view);
  stop();
  return status;
}

CameraInfo McapCamera::info() const {
  char text[128];
  std::snprintf(text, sizeof(text), "recording of %zu segment%s, %dx%d JPEG", segments_.size(),
                segments_.size() == 1 ? "" : "s", format_.width, format_.height);
  return {"mcap:" + path_, text, 0};
}

Status McapCamera::start() {
  if (segments_.empty()) {
    return Status::error(StatusCode::kInvalidInput, "mcap: start before configure");
  }
  for (Slot& slot : slots_) slot.free = true;
  has_pending_ = false;
  sequence_ = 0;
  play_origin_ns_ = 0;
  round_delivered_ = false;
  return open_readable_segment(0);
}

void McapCamera::stop() {
  reader_.reset();
  file_.reset();
}

Result<CapturedFrame> McapCamera::dequeue(std::chrono::milliseconds timeout) {
  if (reader_ == nullptr) {
    return Status::error(StatusCode::kInvalidInput,
                         "mcap:%s: dequeue before start, or after its "
                         "file could not be opened",
                         path_.c_str());
  }
  std::int64_t due = os::monotonic_ns();
  const std::int64_t deadline =
      due + std::chrono::duration_cast<std::chrono::nanoseconds>(timeout).count();
  if (!has_pending_) LCDM_RETURN_IF_ERROR(fetch(deadline));
  int index = -1;
  Slot* slot = find_free_slot(index);

  if (playback_ == Playback::kLive) {
    if (play_origin_ns_ == 0) {
      play_origin_ns_ = due;
      recorded_origin_ns_ = pending_meta_.unix_ns;
    }
    due = std::max(play_origin_ns_ + (pending_meta_.unix_ns - recorded_origin_ns_),
                   last_due_ns_ + kShortestStepNs);
  }
  const std::int64_t until = slot == nullptr ? deadline : std::min(due, deadline);
  std::this_thread::sleep_for(std::chrono::nanoseconds(until - os::monotonic_ns()));
  if (slot == nullptr || due > deadline) {
    return Status::error(StatusCode::kTimeout, "mcap:%s: no frame due or no free buffer",
                         path_.c_str());
  }

  slot->free = false;
  last_due_ns_ = due;
  std::swap(slot->jpeg, pending_);
  has_pending_ = false;
  round_delivered_ = true;
  CapturedFrame frame{index, {format_, pending_meta_, nullptr, slot->jpeg.size()}};
  frame.view.data = reinterpret_cast<const std::uint8_t*>(slot->jpeg.data());
  frame.view.meta.sequence = sequence_++;
  if (playback_ == Playback::kLive) {
    // Live playback plays the part of a camera: the frame was "seen" now.
    frame.view.meta.sensor_ns = os::monotonic_ns();
    frame.view.meta.unix_ns = frame.view.meta.sensor_ns + os::unix_offset_ns();
  }
  return frame;
}

Status McapCamera::requeue(int index) {
  if (index < 0 || index >= kBuffers || slots_[static_cast<std::size_t>(index)].free) {
    return Status::error(StatusCode::kInvalidInput, "mcap: buffer %d is not lent", index);
  }
  slots_[static_cast<std::size_t>(index)].free = true;
  return Status::ok();
}

McapCamera::Slot* McapCamera::find_free_slot(int& index) {
  for (int i = 0; i < kBuffers; ++i) {
    if (!slots_[static_cast<std::size_t>(i)].free) continue;
    index = i;
    return &slots_[static_cast<std::size_t>(i)];
  }
  return nullptr;
}

Status McapCamera::open_segment(std::size_t index) {
  segment_ = index;
  reader_.reset();
  file_.reset(std::fopen(segments_[index].c_str(), "rbe"));
  if (file_ == nullptr) {
    return Status::system(errno, "mcap:%s: cannot open", segments_[index].c_str());
  }
  reader_ = std::make_unique<wire::McapReader>(
      [file = file_.get()](std::span<std::byte> out) -> Result<std::size_t> {
        const std::size_t got = std::fread(out.data(), 1, out.size(), file);
        if (got != out.size() && std::ferror(file) != 0) {
          return Status::system(errno, "mcap: reading the recording failed");
        }
        return got;
      });
  const Status status = reader_->open();
  if (status) return status;
  return Status::error(status.code(), "mcap:%s: %s", segments_[index].c_str(), status.text());
}

Status McapCamera::open_readable_segment(std::size_t index) {
  Status status = open_segment(index);
  while (status.code() == StatusCode::kCorrupt && ++index < segments_.size()) {
    status = open_segment(index);
  }
  return status;
}

// The next message of the recording, crossing segments. kEndOfStream behind the last.
Result<wire::McapMessage> McapCamera::next_message() {
  while (true) {
    auto message = reader_->next();
    if (message.code() != StatusCode::kEndOfStream || segment_ + 1 == segments_.size()) {
      return message;
    }
    const Status status = open_readable_segment(segment_ + 1);
    if (status.code() == StatusCode::kCorrupt) {
      return Status::error(StatusCode::kEndOfStream, "%s", status.text());
    }
    LCDM_RETURN_IF_ERROR(status);
  }
}

// The first of each topic. Of cameras that are not played none is needed.
Status McapCamera::keep_calibration(const wire::McapMessage& message) {
  constexpr std::size_t kMost = 16;
  const std::string topic(message.topic);
  if (calibrations_.contains(topic) || calibrations_.size() == kMost) return Status::ok();
  const auto calibration = wire::decode_camera_calibration(message.data);
  if (calibration) {
    calibrations_.emplace(topic, calibration->model);
  } else if (calibration.code() == StatusCode::kUnsupported) {
    calibrations_.emplace(topic, calibration.status());
  } else {
    return calibration.status();
  }
  return Status::ok();
}

// Of the pictures' camera: what lies beside their topic ("/left/image", "/left/calibration"), or
// the only one there is. Null: none.
const Result<CameraModel>* McapCamera::own_calibration() const {
  const std::string place = topic_.substr(0, topic_.rfind('/') + 1);
  const Result<CameraModel>* only = nullptr;
  for (const auto& [topic, model] : calibrations_) {
    if (topic.substr(0, topic.rfind('/') + 1) == place) return &model;
    only = &model;
  }
  return calibrations_.size() == 1 ? only : nullptr;
}

// Reads on until the next picture lies in pending_. kTimeout: others' messages lay before it for
// too long; the next call goes on there.
Status McapCamera::fetch(std::int64_t deadline_ns) {
  for (bool first = true;; first = false) {
    if (!first && os::monotonic_ns() > deadline_ns) {
      return Status::error(StatusCode::kTimeout, "mcap:%s: no picture yet", path_.c_str());
    }
    const auto message = next_message();
    if (message.code() == StatusCode::kEndOfStream && playback_ == Playback::kLive &&
        round_delivered_) {
      play_origin_ns_ = 0;
      round_delivered_ = false;
      LCDM_RETURN_IF_ERROR(open_readable_segment(0));
      continue;
    }
    if (message.code() == StatusCode::kUnavailable) continue;
    if (!message) return message.status();
    if (message->schema_name == wire::kCameraCalibrationSchema) {
      LCDM_RETURN_IF_ERROR(keep_calibration(*message));
    }
    if (message->schema_name != wire::kCompressedImageSchema) continue;
    if (topic_.empty()) topic_ = message->topic;
    if (message->topic != topic_) continue;  // another camera's
    const auto image = wire::decode_compressed_image(message->data);
    if (!image) return image.status();
    if (image->format != "jpeg" || image->bytes.empty() || image->bytes.size() > kMaxJpeg) {
      return Status::error(StatusCode::kCorrupt, "mcap:%s: an image that is no JPEG: skipped",
                           segments_[segment_].c_str());
    }
    pending_.assign(image->bytes.begin(), image->bytes.end());
    const std::int64_t step = image->unix_ns - pending_meta_.unix_ns;
    if (step < 0 || step > kLongestPauseNs) play_origin_ns_ = 0;
    pending_meta_ = {};
    pending_meta_.unix_ns = image->unix_ns;
    has_pending_ = true;
    return Status::ok();
  }
}

// Goes on to the first picture whose head can be read: a camera's first frames may be damaged, and
// the recorder keeps what came.
Result<FrameFormat> McapCamera::find_first_picture() {
  std::string damage;
  while (true) {
    const Status fetched = fetch(INT64_MAX);
    if (fetched.code() == StatusCode::kCorrupt) continue;
    if (!fetched) {
      return Status::error(StatusCode::kInvalidInput, "mcap:%s: no JPEG pictures in it (%s)",
                           path_.c_str(), damage.empty() ? fetched.text() : damage.c_str());
    }
    Result<FrameFormat> format = JpegDecoder::format_of(
        {reinterpret_cast<const std::uint8_t*>(pending_.data()), pending_.size()});
    if (format) return format;
    damage = format.status().text();
  }
}

// Learns size and intrinsics.
Status McapCamera::inspect_first_frame(float assumed_field_of_view) {
  const Result<FrameFormat> format = find_first_picture();
  if (!format) return format.status();
  format_ = *format;
  if (format_.width > kMaxSide || format_.height > kMaxSide) {
    return Status::error(StatusCode::kUnsupported,
                         "mcap:%s: pictures of %dx%d: at most %d pixels a side can be used",
                         path_.c_str(), format_.width, format_.height, kMaxSide);
  }
  const Result<CameraModel>* calibration = own_calibration();
  if (calibration != nullptr && !*calibration) {
    return Status::error(StatusCode::kInvalidInput, "mcap:%s: %s", path_.c_str(),
                         calibration->status().text());
  }
  model_ = calibration != nullptr ? **calibration
                                  : CameraModel::from_field_of_view(format_.width, format_.height,
                                                                    assumed_field_of_view);
  if (model_.width != format_.width || model_.height != format_.height) {
    return Status::error(StatusCode::kInvalidInput,
                         "mcap:%s: pictures are %dx%d but the calibration says %dx%d",
                         path_.c_str(), format_.width, format_.height, model_.width, model_.height);
  }
  return Status::ok();
}

}  // namespace lcdm
