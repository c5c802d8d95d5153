// A camera whose intrinsics come from a calibration file.
#pragma once

#include <memory>
#include <string>
#include <utility>

#include "app/calibration_file.h"
#include "firmware/pipeline/camera.h"

namespace lcdm {

// The other camera in everything but its model, which is the calibration's, fitted to its pictures'
// size. A camera that knows its own intrinsics keeps them.
class CalibratedCamera final : public Camera {
 public:
  // `pluggable`: another camera may take its place, or it may come back with other sizes.
  CalibratedCamera(std::unique_ptr<Camera> camera, Calibration calibration, bool pluggable)
      : camera_(std::move(camera)), calibration_(std::move(calibration)), pluggable_(pluggable) {}

  // kInvalidInput also: the calibration is of another shape than the camera's pictures. Where it is
  // pluggable kNotFound: the camera that the calibration is of is not there, or not as it was.
  Status configure(const CaptureRequest& request) override {
    LCDM_RETURN_IF_ERROR(camera_->configure(request));
    const CameraModel own = camera_->model();
    if (own.calibrated) return Status::ok();
    const Status fits = model_for(calibration_, own.width, own.height).status();
    if (fits) return fits;
    camera_->close();
    return pluggable_ ? Status::error(StatusCode::kNotFound, "%s", fits.text()) : fits;
  }
  CameraModel model() const override {
    const CameraModel own = camera_->model();
    if (own.calibrated) return own;
    // Files of several shapes: those that do not fit are uncalibrated.
    const Result<CameraModel> fitted = model_for(calibration_, own.width, own.height);
    return fitted ? *fitted : own;
  }

  const FrameFormat& format() const override { return camera_->format(); }
  CameraInfo info() const override { return camera_->info(); }
  int buffer_count() const override { return camera_->buffer_count(); }
  std::string frame_name(std::uint64_t sequence) const override {
    return camera_->frame_name(sequence);
  }
  Status start() override { return camera_->start(); }
  Result<CapturedFrame> dequeue(std::chrono::milliseconds timeout) override {
    return camera_->dequeue(timeout);
  }
  Status requeue(int index) override { return camera_->requeue(index); }
  void stop() override { camera_->stop(); }
  void close() override { camera_->close(); }

 private:
  const std::unique_ptr<Camera> camera_;
  const Calibration calibration_;
  const bool pluggable_;
};

}  // namespace lcdm
