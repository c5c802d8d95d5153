// The light, the button and the heartbeat output of a board, where there are any.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "app/config.h"
#include "drivers/gpio/gpio.h"
#include "firmware/health/indicator.h"

namespace lcdm {

// Belongs to main. Released or dropped, the outputs are at their safe level.
class FrontPanel {
 public:
  // Requests the lines that are named. One that cannot be had is a warning: the device does
  // without.
  explicit FrontPanel(const Config::Gpio& names);

  // Shows the state, beats while the device is alive, and tells what was pressed.
  Press look(DeviceState state, bool alive, std::int64_t now_ns);

  // For good, before an end that may take long.
  void release();

  // Why lines are missing, one line for a person each.
  const std::vector<std::string>& warnings() const { return warnings_; }

 private:
  struct Line {
    std::unique_ptr<GpioLine> gpio;  // null: not wanted, or given up
    int failures = 0;                // in a row
  };

  Line request(const char* key, const std::string& name, GpioUse use);
  void drive(Line& line, bool active);
  void judge(Line& line, const Status& status);

  std::vector<std::string> warnings_;
  Line light_;
  Line button_line_;
  Line heartbeat_;
  Button button_;
  DeviceState state_ = DeviceState::kBooting;
  std::int64_t state_since_ns_ = 0;
};

}  // namespace lcdm
