#include "drivers/v4l2/controls.h"

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <optional>

namespace lcdm {
namespace {

// The value that a control then has: drivers take the nearest they can do. Empty: refused.
std::optional<int> set(const V4l2Device& device, std::uint32_t id, int value) {
  v4l2_control control{id, value};
  if (device.control(VIDIOC_S_CTRL, &control) != 0) return std::nullopt;
  return control.value;
}

// What came of what was asked for.
class Outcome {
 public:
  // `unit` is what a person reads behind the value, which counts `per_unit` to one.
  void note(const char* name, int asked, std::optional<int> became, int per_unit = 1,
            const char* unit = "") {
    if (!became) add(refused_, name);
    if (!became || *became == asked) return;
    char text[64];
    std::snprintf(text, sizeof(text), "%s to %g%s", name, static_cast<double>(*became) / per_unit,
                  unit);
    add(changed_, text);
  }

  std::string text() const {
    std::string text;
    if (!refused_.empty()) text += "; it cannot set " + refused_;
    if (!changed_.empty()) text += "; it sets " + changed_;
    return text;
  }

 private:
  static void add(std::string& list, const std::string& item) {
    list += (list.empty() ? "" : ", ") + item;
  }

  std::string refused_;
  std::string changed_;
};

// UVC cameras know the mode that leaves the aperture alone, others only the full one.
void set_exposure_automatic(const V4l2Device& device) {
  if (!set(device, V4L2_CID_EXPOSURE_AUTO, V4L2_EXPOSURE_APERTURE_PRIORITY)) {
    set(device, V4L2_CID_EXPOSURE_AUTO, V4L2_EXPOSURE_AUTO);
  }
}

void set_exposure(const V4l2Device& device, double milliseconds, Outcome& outcome) {
  constexpr int kStepsPerMillisecond = 10;
  const auto steps = static_cast<int>(std::lround(milliseconds * kStepsPerMillisecond));
  set(device, V4L2_CID_EXPOSURE_AUTO, V4L2_EXPOSURE_MANUAL);
  outcome.note("exposure", steps, set(device, V4L2_CID_EXPOSURE_ABSOLUTE, steps),
               kStepsPerMillisecond, " ms");
}

void set_gain(const V4l2Device& device, double wanted, Outcome& outcome) {
  const auto gain = static_cast<int>(std::lround(wanted));
  set(device, V4L2_CID_AUTOGAIN, 0);
  outcome.note("gain", gain, set(device, V4L2_CID_GAIN, gain));
}

void set_white_balance(const V4l2Device& device, int kelvin, Outcome& outcome) {
  set(device, V4L2_CID_AUTO_WHITE_BALANCE, 0);
  outcome.note("white balance", kelvin, set(device, V4L2_CID_WHITE_BALANCE_TEMPERATURE, kelvin), 1,
               " K");
}

void set_power_line(const V4l2Device& device, int hertz, Outcome& outcome) {
  const int value =
      hertz == 50 ? V4L2_CID_POWER_LINE_FREQUENCY_50HZ : V4L2_CID_POWER_LINE_FREQUENCY_60HZ;
  const std::optional<int> became = set(device, V4L2_CID_POWER_LINE_FREQUENCY, value);
  // A choice from a menu: another one than ours is a refusal.
  outcome.note("mains frequency", value, became == value ? became : std::nullopt);
}

}  // namespace

std::string apply_controls(const V4l2Device& device, const ImageControls& controls) {
  Outcome outcome;
  // In low light many cameras would rather halve the rate than darken the picture; robots would
  // not. Not every camera has the control.
  set(device, V4L2_CID_EXPOSURE_AUTO_PRIORITY, 0);

  if (controls.exposure_ms > 0) {
    set_exposure(device, controls.exposure_ms, outcome);
  } else {
    set_exposure_automatic(device);
  }
  if (controls.gain >= 0) {
    set_gain(device, controls.gain, outcome);
  } else {
    set(device, V4L2_CID_AUTOGAIN, 1);
  }
  if (controls.white_balance_kelvin > 0) {
    set_white_balance(device, controls.white_balance_kelvin, outcome);
  } else {
    set(device, V4L2_CID_AUTO_WHITE_BALANCE, 1);
  }
  if (controls.power_line_hz > 0) {
    set_power_line(device, controls.power_line_hz, outcome);
  } else {
    set(device, V4L2_CID_POWER_LINE_FREQUENCY, V4L2_CID_POWER_LINE_FREQUENCY_AUTO);
  }
  return outcome.text();
}

}  // namespace lcdm
