// What a person without a screen sees and presses: the patterns of the light, and the button.
#pragma once

#include <cstdint>
#include <string_view>

#include "firmware/health/supervisor.h"

namespace lcdm {

// How the light blinks in a state: one character for each 100 ms, '#' is lit; from its end it
// begins again.
std::string_view light_pattern(DeviceState state);

// Whether the light is lit, `since_ns` after the state began.
bool is_lit(DeviceState state, std::int64_t since_ns);

enum class Press : std::uint8_t {
  kNone,
  kShort,  // let go before it was long
  kLong,   // held for 3 s; told while it is still held
};

// Debounces a button that is looked at every 50 ms or so: what does not last for two looks and
// 40 ms is no press. One that is pressed when we first look (stuck, or held since power-on) is
// nothing until it was let go.
class Button {
 public:
  Press look(bool pressed, std::int64_t now_ns);

 private:
  bool raw_ = true;  // as of the last look
  std::int64_t raw_since_ns_ = -1;
  bool pressed_ = true;  // debounced
  std::int64_t pressed_since_ns_ = 0;
  bool told_ = true;  // this press was told, or must not be
};

}  // namespace lcdm
