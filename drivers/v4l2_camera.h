// `v4l2:/dev/...`: a camera behind the kernel's Video4Linux interface, by memory-mapped streaming.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "firmware/pipeline/camera.h"

namespace lcdm {

// One /dev/video* node, and why it is of no use if it is not.
struct V4l2Node {
  std::string path;
  std::string card;     // the driver's name for the camera
  bool usable = false;  // captures video by streaming, in a format we read
  std::string reason;   // when not usable: one clause with the cure
};

// Every /dev/video* node, in the order of their numbers. Opens each for a moment.
std::vector<V4l2Node> list_v4l2_nodes();

// Single-planar YUYV or MJPEG. The kernel's buffers are the camera's buffers: frames are read in
// place. Threads: as Camera. Between start and stop nothing allocates.
class V4l2Camera final : public Camera {
 public:
  // `device` is a node or a link to one (/dev/v4l/by-id/... survives replugging, /dev/video0
  // moves).
  explicit V4l2Camera(std::string device);
  ~V4l2Camera() override;
  V4l2Camera(const V4l2Camera&) = delete;
  V4l2Camera& operator=(const V4l2Camera&) = delete;

  Status configure(const CaptureRequest& request) override;
  const FrameFormat& format() const override { return format_; }
  CameraModel model() const override { return model_; }
  CameraInfo info() const override;
  int buffer_count() const override { return static_cast<int>(buffers_.size()); }
  Status start() override;
  Result<CapturedFrame> dequeue(std::chrono::milliseconds timeout) override;
  Status requeue(int index) override;
  void stop() override;

 private:
  struct Mapping {
    void* memory = nullptr;
    std::size_t length = 0;
  };

  Status open_device();
  Status check_capabilities();
  Status set_format(const CaptureRequest& request);
  Status set_rate(float frames_per_second);
  Status map_buffers();
  void close_device();
  Status wait_readable(std::int64_t deadline_ns) const;
  Status no_frame() const;
  Status failure(int sys_errno, const char* what) const;
  std::uint64_t extend_sequence(std::uint32_t sequence);

  const std::string device_;
  int fd_ = -1;
  bool streaming_ = false;
  std::string card_;
  FrameFormat format_;
  CameraModel model_;
  float frames_per_second_ = 0;  // 0: the driver does not say
  std::vector<Mapping> buffers_;
  bool first_frame_ = true;
  std::uint32_t last_sequence_ = 0;  // the driver's, 32 bits
  std::uint64_t sequence_ = 0;       // ours, never wraps
};

}  // namespace lcdm
