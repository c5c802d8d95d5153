// `v4l2:...`: a camera behind the kernel's Video4Linux interface, by memory-mapped streaming.
#pragma once

#include <cstdint>
#include <string>

#include "drivers/v4l2/device.h"
#include "drivers/v4l2/queue.h"
#include "firmware/buffer/sequence_counter.h"
#include "firmware/pipeline/camera.h"

namespace lcdm {

// The kernel's buffers are the camera's buffers: frames are read in place. Threads: as Camera.
// Between start and stop nothing allocates.
class V4l2Camera final : public Camera {
 public:
  // `selector` is a node, a link to one (/dev/v4l/by-id/... survives replugging, /dev/video0
  // moves), any, serial=TEXT or name=TEXT: see find_v4l2_node. Looked up at every configure.
  explicit V4l2Camera(std::string selector);

  Status configure(const CaptureRequest& request) override;
  const FrameFormat& format() const override { return format_; }
  CameraModel model() const override { return model_; }
  CameraInfo info() const override;
  int buffer_count() const override { return queue_.size(); }
  Status start() override;
  Result<CapturedFrame> dequeue(std::chrono::milliseconds timeout) override;
  Status requeue(int index) override { return queue_.enqueue(index); }
  void stop() override { queue_.stop(); }
  void close() override;

 private:
  Status open_and_configure(const CaptureRequest& request);
  Status take(V4l2Filled& filled, std::chrono::milliseconds timeout);
  Status wait_readable(std::int64_t deadline_ns);
  Status take_event();
  Status no_frame() const;

  const std::string selector_;
  V4l2Device device_;
  V4l2Queue queue_{device_};  // destroyed before the device
  FrameFormat format_;
  std::size_t frame_bytes_ = 0;  // that a whole frame has at least
  CameraModel model_;
  float frames_per_second_ = 0;  // 0: the driver does not say
  std::string reason_;           // why this format
  std::string otherwise_;        // what became of controls, where not what was asked for
  std::string usb_;
  SequenceCounter sequence_;
};

}  // namespace lcdm
