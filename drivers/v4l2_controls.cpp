#include "drivers/v4l2_controls.h"

#include <cmath>
#include <cstdint>

namespace lcdm {
namespace {

bool set(const V4l2Device& device, std::uint32_t id, int value) {
  v4l2_control control{id, value};
  return device.control(VIDIOC_S_CTRL, &control) == 0;
}

// UVC cameras know the mode that leaves the aperture alone, others only the full one.
void set_exposure_automatic(const V4l2Device& device) {
  if (!set(device, V4L2_CID_EXPOSURE_AUTO, V4L2_EXPOSURE_APERTURE_PRIORITY)) {
    set(device, V4L2_CID_EXPOSURE_AUTO, V4L2_EXPOSURE_AUTO);
  }
}

bool set_exposure(const V4l2Device& device, double milliseconds) {
  set(device, V4L2_CID_EXPOSURE_AUTO, V4L2_EXPOSURE_MANUAL);
  const auto steps = static_cast<int>(std::lround(milliseconds * 10));  // of 100 us
  return set(device, V4L2_CID_EXPOSURE_ABSOLUTE, steps);
}

bool set_power_line(const V4l2Device& device, int hertz) {
  const int value =
      hertz == 50 ? V4L2_CID_POWER_LINE_FREQUENCY_50HZ : V4L2_CID_POWER_LINE_FREQUENCY_60HZ;
  return set(device, V4L2_CID_POWER_LINE_FREQUENCY, value);
}

}  // namespace

std::string apply_controls(const V4l2Device& device, const ImageControls& controls) {
  std::string refused;
  const auto note = [&refused](bool done, const char* name) {
    if (!done) refused += (refused.empty() ? "" : ", ") + std::string(name);
  };
  // In low light many cameras would rather halve the rate than darken the picture; robots would
  // not. Not every camera has the control.
  set(device, V4L2_CID_EXPOSURE_AUTO_PRIORITY, 0);

  if (controls.exposure_ms > 0) {
    note(set_exposure(device, controls.exposure_ms), "exposure");
  } else {
    set_exposure_automatic(device);
  }
  if (controls.gain >= 0) {
    set(device, V4L2_CID_AUTOGAIN, 0);
    note(set(device, V4L2_CID_GAIN, static_cast<int>(std::lround(controls.gain))), "gain");
  } else {
    set(device, V4L2_CID_AUTOGAIN, 1);
  }
  if (controls.white_balance_kelvin > 0) {
    set(device, V4L2_CID_AUTO_WHITE_BALANCE, 0);
    note(set(device, V4L2_CID_WHITE_BALANCE_TEMPERATURE, controls.white_balance_kelvin),
         "white balance");
  } else {
    set(device, V4L2_CID_AUTO_WHITE_BALANCE, 1);
  }
  if (controls.power_line_hz > 0) {
    note(set_power_line(device, controls.power_line_hz), "mains frequency");
  } else {
    set(device, V4L2_CID_POWER_LINE_FREQUENCY, V4L2_CID_POWER_LINE_FREQUENCY_AUTO);
  }
  return refused;
}

}  // namespace lcdm
