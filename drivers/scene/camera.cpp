#include "drivers/scene/camera.h"

#include <algorithm>
#include <cstdio>
#include <thread>

#include "drivers/scene/render.h"
#include "drivers/scene/textures.h"
#include "firmware/base/os.h"

namespace lcdm {
namespace {

constexpr int kLeastSide = 16;
constexpr int kMostSide = 4096;

std::int64_t to_ns(std::chrono::milliseconds time) {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(time).count();
}

}  // namespace

SceneCamera::SceneCamera(std::uint64_t seed) : seed_(seed), scene_(seed) {}

Status SceneCamera::configure(const CaptureRequest& request) {
  stop();
  if (std::min(request.width, request.height) < kLeastSide ||
      std::max(request.width, request.height) > kMostSide) {
    return Status::error(StatusCode::kInvalidInput,
                         "scene: cannot render %dx%d: set [camera] width and height from %d to %d",
                         request.width, request.height, kLeastSide, kMostSide);
  }
  if (!(request.frames_per_second > 0) || request.frames_per_second > 1000) {
    return Status::error(StatusCode::kInvalidInput,
                         "scene: cannot render %g frames/s: set [camera] frames_per_second above 0",
                         static_cast<double>(request.frames_per_second));
  }
  if (!(request.assumed_field_of_view > 1) || request.assumed_field_of_view > 170) {
    return Status::error(
        StatusCode::kInvalidInput,
        "scene: field of view %g: set [camera] field_of_view from 1 to 170 degrees",
        static_cast<double>(request.assumed_field_of_view));
  }
  format_ = {PixelFormat::kRgb24, request.width, request.height,
             packed_stride(PixelFormat::kRgb24, request.width)};
  model_ =
      CameraModel::from_field_of_view(request.width, request.height, request.assumed_field_of_view);
  model_.calibrated = true;  // it is rendered with exactly these
  frames_per_second_ = request.frames_per_second;
  const std::size_t bytes =
      static_cast<std::size_t>(format_.stride) * static_cast<std::size_t>(format_.height);
  for (Buffer& buffer : buffers_) buffer.rgb.assign(bytes, 0);
  scene::textures();
  return Status::ok();
}

CameraInfo SceneCamera::info() const {
  char text[128];
  std::snprintf(text, sizeof(text), "rendered %s (seed %llu), %dx%d at %.4g frames/s",
                scene_.kind_name(), static_cast<unsigned long long>(seed_), format_.width,
                format_.height, static_cast<double>(frames_per_second_));
  return {"scene:" + std::to_string(seed_), text, frames_per_second_};
}

Status SceneCamera::start() {
  if (format_.width == 0) {
    return Status::error(StatusCode::kInvalidInput, "scene: start before configure");
  }
  for (Buffer& buffer : buffers_) buffer.free = true;
  streaming_ = true;
  sequence_ = 0;
  start_ns_ = due_ns_ = os::monotonic_ns();
  return Status::ok();
}

void SceneCamera::stop() { streaming_ = false; }

Result<CapturedFrame> SceneCamera::dequeue(std::chrono::milliseconds timeout) {
  if (!streaming_) return Status::error(StatusCode::kInvalidInput, "scene: dequeue before start");
  const auto buffer = std::find_if(buffers_.begin(), buffers_.end(),
                                   [](const Buffer& candidate) { return candidate.free; });
  const std::int64_t deadline = os::monotonic_ns() + to_ns(timeout);
  const bool in_time = buffer != buffers_.end() && due_ns_ <= deadline;
  const std::int64_t until = in_time ? due_ns_ : deadline;
  std::this_thread::sleep_for(std::chrono::nanoseconds(until - os::monotonic_ns()));
  if (!in_time) {
    return Status::error(StatusCode::kTimeout, "scene: no frame due or no free buffer");
  }

  const std::int64_t now = os::monotonic_ns();
  const auto period = static_cast<std::int64_t>(1e9 / static_cast<double>(frames_per_second_));
  due_ns_ = std::max(due_ns_ + period, now);
  scene::render(scene_, static_cast<double>(now - start_ns_) * 1e-9, model_, buffer->rgb, {});
  buffer->free = false;

  CapturedFrame frame;
  frame.index = static_cast<int>(buffer - buffers_.begin());
  frame.view.format = format_;
  frame.view.meta = {sequence_++, now, now + os::unix_offset_ns()};
  frame.view.data = buffer->rgb.data();
  frame.view.bytes = buffer->rgb.size();
  return frame;
}

Status SceneCamera::requeue(int index) {
  if (index < 0 || index >= kBuffers || buffers_[static_cast<std::size_t>(index)].free) {
    return Status::error(StatusCode::kInvalidInput, "scene: buffer %d is not lent", index);
  }
  buffers_[static_cast<std::size_t>(index)].free = true;
  return Status::ok();
}

}  // namespace lcdm
