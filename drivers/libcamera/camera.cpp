// The streaming half of a session, and the Camera around it.
#include "drivers/libcamera/camera.h"

#include <algorithm>
#include <cstdio>
#include <time.h>
#include <utility>

#include "drivers/libcamera/session.h"
#include "firmware/base/os.h"

namespace lcdm {
namespace {

// A frame that waited longer for us cannot be: by then the watchdog has ended the process.
constexpr std::int64_t kOldestNs = 10'000'000'000;

Clocks read_clocks() {
  timespec boottime{};
  clock_gettime(CLOCK_BOOTTIME, &boottime);
  return {os::monotonic_ns(),
          static_cast<std::int64_t>(boottime.tv_sec) * 1'000'000'000 + boottime.tv_nsec};
}

}  // namespace

// libcamera promises CLOCK_BOOTTIME; some pipeline handlers hand on the kernel's CLOCK_MONOTONIC.
// Where the machine has slept the two lie apart by that, and the wrong reading lies in the future
// or longer ago.
std::optional<std::int64_t> monotonic_stamp(std::int64_t stamp_ns, const Clocks& now) {
  if (stamp_ns <= 0) return std::nullopt;
  std::optional<std::int64_t> nearest;
  for (const std::int64_t now_ns : {now.monotonic_ns, now.boottime_ns}) {
    if (stamp_ns > now_ns || now_ns - stamp_ns > kOldestNs) continue;
    const std::int64_t read_ns = now.monotonic_ns - (now_ns - stamp_ns);
    nearest = std::max(nearest.value_or(read_ns), read_ns);
  }
  return nearest;
}

CameraInfo LibcameraSession::info() const {
  char text[240];
  std::snprintf(text, sizeof(text), "%.80s, %s %dx%d%s%s", id_.c_str(), to_string(format.pixel),
                format.width, format.height, refused_.empty() ? "" : "; it cannot set ",
                refused_.c_str());
  return {"libcamera:" + id_, text, frames_per_second_, stamp_};
}

Status LibcameraSession::start() {
  if (slots_.empty()) {
    return Status::error(StatusCode::kInvalidInput, "libcamera:%s: not configured", id_.c_str());
  }
  ring_size_ = 0;
  sequence_.reset();
  if (const int result = camera_->start(&controls_); result != 0) {
    return failure(result, "cannot start streaming");
  }
  running_ = true;
  for (int i = 0; i < buffer_count(); ++i) LCDM_RETURN_IF_ERROR(requeue(i));
  return Status::ok();
}

// libcamera's stop waits until its thread has given up every request.
void LibcameraSession::stop() {
  if (!running_) return;
  camera_->stop();
  running_ = false;
  const std::lock_guard lock(mutex_);
  ring_size_ = 0;
}

Result<CapturedFrame> LibcameraSession::dequeue(std::chrono::milliseconds timeout) {
  Completed done;
  {
    std::unique_lock lock(mutex_);
    filled_.wait_for(lock, timeout, [this] { return ring_size_ > 0 || gone_; });
    if (gone_) {
      return Status::error(StatusCode::kDeviceGone, "libcamera:%s: the camera is gone",
                           id_.c_str());
    }
    if (ring_size_ == 0) {
      return Status::error(StatusCode::kTimeout, "libcamera:%s: no frame in time", id_.c_str());
    }
    done = ring_[ring_begin_];
    ring_begin_ = (ring_begin_ + 1) % ring_.size();
    --ring_size_;
  }
  const Slot& slot = slots_[static_cast<std::size_t>(done.index)];
  const std::uint64_t sequence = sequence_.next(done.count);
  const std::size_t needed = format.pixel == PixelFormat::kMjpeg ? 1 : picture_bytes(format);
  if (!done.whole || done.bytes < needed || done.bytes > slot.length) {
    LCDM_RETURN_IF_ERROR(requeue(done.index));
    return Status::error(StatusCode::kCorrupt, "libcamera:%s: damaged frame (%zu bytes)",
                         id_.c_str(), done.bytes);
  }
  // A camera that was wrong once is not asked again: the stamps of one stream mean one thing.
  if (!done.stamp_ns) stamp_ = StampSource::kArrival;
  CapturedFrame frame;
  frame.index = done.index;
  frame.stamp = stamp_;
  frame.view.format = format;
  frame.view.data = static_cast<const std::uint8_t*>(slot.memory) + slot.offset;
  frame.view.bytes = done.bytes;
  frame.view.meta.sequence = sequence;
  frame.view.meta.sensor_ns = stamp_ == StampSource::kArrival ? done.arrival_ns : *done.stamp_ns;
  frame.view.meta.unix_ns = frame.view.meta.sensor_ns + os::unix_offset_ns();
  return frame;
}

Status LibcameraSession::requeue(int index) {
  if (index < 0 || index >= buffer_count()) {
    return Status::error(StatusCode::kInvalidInput, "libcamera:%s: no buffer %d", id_.c_str(),
                         index);
  }
  libcamera::Request* request = slots_[static_cast<std::size_t>(index)].request.get();
  request->reuse(libcamera::Request::ReuseBuffers);
  if (const int result = camera_->queueRequest(request); result != 0) {
    return failure(result, "cannot give a buffer back");
  }
  return Status::ok();
}

// On libcamera's thread. Whatever is not a whole frame is unusable: newer versions have more
// reasons than older ones.
void LibcameraSession::on_complete(libcamera::Request* request) {
  if (request->status() == libcamera::Request::RequestCancelled) return;
  Completed done;
  done.index = static_cast<int>(request->cookie());
  const libcamera::FrameMetadata& metadata =
      slots_[static_cast<std::size_t>(done.index)].buffer->metadata();
  done.whole = metadata.status == libcamera::FrameMetadata::FrameSuccess;
  done.count = metadata.sequence;
  const auto sensor = request->metadata().get(libcamera::controls::SensorTimestamp);
  const Clocks now = read_clocks();
  done.arrival_ns = now.monotonic_ns;
  done.stamp_ns =
      monotonic_stamp(sensor ? *sensor : static_cast<std::int64_t>(metadata.timestamp), now);
  for (const auto& plane : metadata.planes()) done.bytes += plane.bytesused;
  const std::lock_guard lock(mutex_);
  ring_[(ring_begin_ + ring_size_) % ring_.size()] = done;
  ++ring_size_;
  filled_.notify_one();
}

void LibcameraSession::on_disconnect() {
  const std::lock_guard lock(mutex_);
  gone_ = true;
  filled_.notify_one();
}

std::vector<std::string> list_libcamera_cameras() {
  std::vector<std::string> ids;
  if (const auto manager = shared_libcamera_manager()) {
    for (const auto& camera : manager->cameras()) ids.push_back(camera->id());
  }
  return ids;
}

LibcameraCamera::LibcameraCamera(std::string id)
    : session_(std::make_unique<LibcameraSession>(std::move(id))) {}
LibcameraCamera::~LibcameraCamera() = default;

Status LibcameraCamera::configure(const CaptureRequest& request) {
  return session_->configure(request);
}
const FrameFormat& LibcameraCamera::format() const { return session_->format; }
CameraModel LibcameraCamera::model() const { return session_->model; }
CameraInfo LibcameraCamera::info() const { return session_->info(); }
int LibcameraCamera::buffer_count() const { return session_->buffer_count(); }
Status LibcameraCamera::start() { return session_->start(); }
Result<CapturedFrame> LibcameraCamera::dequeue(std::chrono::milliseconds timeout) {
  return session_->dequeue(timeout);
}
Status LibcameraCamera::requeue(int index) { return session_->requeue(index); }
void LibcameraCamera::stop() { session_->stop(); }
void LibcameraCamera::close() { session_->close(); }

}  // namespace lcdm
