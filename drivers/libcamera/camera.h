// `libcamera:ID`: a camera that needs libcamera, as sensors on a ribbon cable do. Built only where
// libcamera 0.0.3 or newer is installed; LCDM_LIBCAMERA is then defined.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "firmware/pipeline/camera.h"

namespace lcdm {

class LibcameraSession;

// The ids of all cameras that libcamera knows, USB cameras among them. Empty also where it cannot
// be started.
std::vector<std::string> list_libcamera_cameras();

// Frames are read in place from the buffers that libcamera allocates. libcamera runs a thread of
// its own and allocates for every frame: not sealed. Threads: as Camera.
class LibcameraCamera final : public Camera {
 public:
  explicit LibcameraCamera(std::string id);
  ~LibcameraCamera() override;
  LibcameraCamera(const LibcameraCamera&) = delete;
  LibcameraCamera& operator=(const LibcameraCamera&) = delete;

  Status configure(const CaptureRequest& request) override;
  const FrameFormat& format() const override;
  CameraModel model() const override;
  CameraInfo info() const override;
  int buffer_count() const override;
  Status start() override;
  Result<CapturedFrame> dequeue(std::chrono::milliseconds timeout) override;
  Status requeue(int index) override;
  void stop() override;
  void close() override;

 private:
  std::unique_ptr<LibcameraSession> session_;  // keeps libcamera's types out of this header
};

}  // namespace lcdm
