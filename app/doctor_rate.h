// How many frames a second really come from a camera: drivers list what light, exposure and bus do
// not always give.
#pragma once

#include <string>

#include "app/config.h"
#include "firmware/base/status.h"
#include "firmware/pipeline/camera.h"

namespace lcdm {

// Frames/s of a camera that is not configured yet. Opens it and takes about two seconds. A camera
// that somebody else holds: EBUSY in sys_errno().
Result<float> measure_rate(Camera& camera, const CaptureRequest& request);

// Frames/s that the `lcdm run` with this configuration gets from its camera, by its own counters.
// Takes a second. kUnavailable: none answers, or it shows another source than `uri`.
Result<float> served_rate(const Config& config, const std::string& uri);

}  // namespace lcdm
