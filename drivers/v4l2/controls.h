// Exposure, gain, white balance and mains frequency, by the controls a camera has.
#pragma once

#include <string>

#include "drivers/v4l2/device.h"
#include "firmware/pipeline/camera.h"

namespace lcdm {

// Sets what is asked for, and automatic where nothing is; a rate never halves in low light. Says
// what was asked for and came out otherwise ("; it cannot set gain; it sets exposure to 30 ms");
// empty when all is well.
std::string apply_controls(const V4l2Device& device, const ImageControls& controls);

}  // namespace lcdm
