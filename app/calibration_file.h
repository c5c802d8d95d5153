// The file that `lcdm calibrate` writes: a camera's intrinsics and lens, and how good they are.
#pragma once

#include <string>

#include "firmware/base/status.h"
#include "firmware/vision/camera_model.h"

namespace lcdm {

struct Calibration {
  std::string camera;    // the source it was made with
  std::string date;      // UTC, as 2026-11-21T11:30:05Z
  int views = 0;         // of the board
  double rms_error = 0;  // pixels, of the corners shown again through the model
  CameraModel model;     // calibrated; of the size it was made at
};

// Strict: every key must be there, none may be unknown. kInvalidInput: "file:line:column: text".
Result<Calibration> read_calibration(const std::string& file);

// The whole file or none: what was there before stays until the new one is complete.
Status write_calibration(const std::string& file, const Calibration& calibration);

// The model for pictures of this size. kInvalidInput: of another shape, which shows another cut of
// the view.
Result<CameraModel> model_for(const Calibration& calibration, int width, int height);

}  // namespace lcdm
