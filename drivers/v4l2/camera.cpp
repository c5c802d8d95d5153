#include "drivers/v4l2/camera.h"

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <poll.h>
#include <thread>
#include <utility>

#include "drivers/v4l2/controls.h"
#include "drivers/v4l2/formats.h"
#include "drivers/v4l2/nodes.h"
#include "firmware/base/os.h"

namespace lcdm {

V4l2Camera::V4l2Camera(std::string selector) : selector_(std::move(selector)) {}

Status V4l2Camera::configure(const CaptureRequest& request) {
  close();
  const Status status = open_and_configure(request);
  if (!status) close();
  return status;
}

Status V4l2Camera::open_and_configure(const CaptureRequest& request) {
  const Result<std::string> node = find_v4l2_node(selector_);
  if (!node) return node.status();
  usb_ = usb_node_of(*node);  // before anything that a reset of its port may cure
  LCDM_RETURN_IF_ERROR(device_.open(*node));
  const std::vector<V4l2Mode> modes = list_modes(device_, request);
  const std::optional<V4l2Choice> choice = choose_mode(modes, request);
  if (!choice) return no_known_format(device_, modes, request);
  const Result<FrameFormat> format = queue_.set_format(*choice);
  if (!format) return format.status();
  format_ = *format;
  frame_bytes_ = format_.pixel == PixelFormat::kMjpeg ? 1 : picture_bytes(format_);
  reason_ = choice->reason;
  otherwise_ = apply_controls(device_, request.controls);
  frames_per_second_ = queue_.set_rate(request.frames_per_second);
  LCDM_RETURN_IF_ERROR(queue_.map());
  // Drivers whose source never changes refuse this, rightly.
  v4l2_event_subscription changes{};
  changes.type = V4L2_EVENT_SOURCE_CHANGE;
  device_.control(VIDIOC_SUBSCRIBE_EVENT, &changes);
  model_ =
      CameraModel::from_field_of_view(format_.width, format_.height, request.assumed_field_of_view);
  return Status::ok();
}

void V4l2Camera::close() {
  queue_.unmap();
  device_.close();
}

CameraInfo V4l2Camera::info() const {
  char rate[32] = "an unknown rate";
  if (frames_per_second_ > 0) {
    std::snprintf(rate, sizeof(rate), "%.1f frames/s", static_cast<double>(frames_per_second_));
  }
  char text[320];
  std::snprintf(text, sizeof(text), "%.64s, %s %dx%d at %s%s%s%s", device_.card().c_str(),
                to_string(format_.pixel), format_.width, format_.height, rate,
                reason_.empty() ? "" : ", ", reason_.c_str(), otherwise_.c_str());
  return {"v4l2:" + selector_, text, frames_per_second_, queue_.stamp(), usb_};
}

Status V4l2Camera::start() {
  sequence_.reset();
  return queue_.start();
}

Result<CapturedFrame> V4l2Camera::dequeue(std::chrono::milliseconds timeout) {
  V4l2Filled filled;
  LCDM_RETURN_IF_ERROR(take(filled, timeout));
  const std::uint64_t sequence = sequence_.next(filled.sequence);
  if (filled.ours) {
    return Status::error(StatusCode::kCorrupt,
                         "v4l2:%s: the driver filled a buffer it did not have", selector_.c_str());
  }
  if ((filled.flags & V4L2_BUF_FLAG_ERROR) != 0 || filled.bytes < frame_bytes_) {
    LCDM_RETURN_IF_ERROR(requeue(filled.index));
    return Status::error(StatusCode::kCorrupt, "v4l2:%s: damaged frame (%zu bytes, flags %x)",
                         selector_.c_str(), filled.bytes, filled.flags);
  }
  CapturedFrame frame;
  frame.index = filled.index;
  frame.stamp = queue_.stamp();
  frame.view.format = format_;
  frame.view.data = filled.data;
  frame.view.bytes = filled.bytes;
  frame.view.meta.sequence = sequence;
  frame.view.meta.sensor_ns = filled.stamp_ns;
  frame.view.meta.unix_ns = frame.view.meta.sensor_ns + os::unix_offset_ns();
  return frame;
}

Status V4l2Camera::take(V4l2Filled& filled, std::chrono::milliseconds timeout) {
  const std::int64_t deadline =
      os::monotonic_ns() + std::chrono::duration_cast<std::chrono::nanoseconds>(timeout).count();
  while (true) {
    LCDM_RETURN_IF_ERROR(wait_readable(deadline));
    const int fault = queue_.dequeue(filled);
    if (fault == 0) return Status::ok();
    if (fault != EAGAIN) return device_.failure(fault, "cannot take a frame");
    // Readable, yet nothing to take: rare, and not worth spinning on.
    if (os::monotonic_ns() >= deadline) return no_frame();
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
}

// Waits until a frame can be taken: kTimeout at the deadline.
Status V4l2Camera::wait_readable(std::int64_t deadline_ns) {
  while (true) {
    const std::int64_t left = deadline_ns - os::monotonic_ns();
    pollfd descriptor{device_.fd(), POLLIN | POLLPRI, 0};
    const int ready = poll(
        &descriptor, 1, static_cast<int>(std::max<std::int64_t>(0, (left + 999'999) / 1'000'000)));
    if (ready < 0 && errno != EINTR) return device_.failure(errno, "cannot wait for a frame");
    if (ready > 0 && (descriptor.revents & POLLPRI) != 0) LCDM_RETURN_IF_ERROR(take_event());
    // An error or hang-up is told apart by what DQBUF then says.
    if (ready > 0 && (descriptor.revents & ~POLLPRI) != 0) return Status::ok();
    if (left <= 0) return no_frame();
  }
}

// kUnavailable: what the buffers hold is no longer what was agreed on.
Status V4l2Camera::take_event() {
  v4l2_event event{};
  if (device_.control(VIDIOC_DQEVENT, &event) != 0 || event.type != V4L2_EVENT_SOURCE_CHANGE) {
    return Status::ok();
  }
  return Status::error(StatusCode::kUnavailable, "v4l2:%s: the source changed its format",
                       selector_.c_str());
}

Status V4l2Camera::no_frame() const {
  return Status::error(StatusCode::kTimeout, "v4l2:%s: no frame in time", selector_.c_str());
}

}  // namespace lcdm
