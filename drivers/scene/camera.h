// `scene:SEED`: a camera that looks at a rendered world.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "drivers/scene/scene.h"
#include "firmware/pipeline/camera.h"

namespace lcdm {

// RGB24 at the requested size and rate, or slower where the processor cannot keep up: then each
// frame still shows the moment of its stamp. Exact intrinsics. Endless. Threads: as Camera; the
// picture is rendered in dequeue, on the caller's thread. Between start and stop nothing allocates.
class SceneCamera final : public Camera {
 public:
  explicit SceneCamera(std::uint64_t seed);

  Status configure(const CaptureRequest& request) override;
  const FrameFormat& format() const override { return format_; }
  CameraModel model() const override { return model_; }
  CameraInfo info() const override;
  int buffer_count() const override { return kBuffers; }
  Status start() override;
  Result<CapturedFrame> dequeue(std::chrono::milliseconds timeout) override;
  Status requeue(int index) override;
  void stop() override;

 private:
  static constexpr int kBuffers = 5;

  struct Buffer {
    std::vector<std::uint8_t> rgb;
    bool free = true;
  };

  const std::uint64_t seed_;
  const scene::Scene scene_;
  FrameFormat format_;
  CameraModel model_;
  float frames_per_second_ = 0;
  std::array<Buffer, kBuffers> buffers_;
  bool streaming_ = false;
  std::uint64_t sequence_ = 0;
  std::int64_t start_ns_ = 0;  // MONOTONIC time of the scene's beginning
  std::int64_t due_ns_ = 0;    // when the next frame may be taken
};

}  // namespace lcdm
