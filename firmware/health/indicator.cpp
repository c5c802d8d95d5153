#include "firmware/health/indicator.h"

namespace lcdm {
namespace {

constexpr std::int64_t kStepNs = 100'000'000;
constexpr std::int64_t kBounceNs = 40'000'000;
constexpr std::int64_t kLongNs = 3'000'000'000;

}  // namespace

// The same patterns stand in app/README.md and systemd/lcdm.toml; a test holds them to each other.
std::string_view light_pattern(DeviceState state) {
  switch (state) {
    case DeviceState::kBooting:
      return "#####.....";
    case DeviceState::kWaitingForCamera:
      return "#...................";
    case DeviceState::kStreaming:
      return "#";
    case DeviceState::kRecording:
      return "#########.";
    case DeviceState::kDegraded:
      return "#..#................";
    case DeviceState::kFault:
      return "#.";
  }
  return "#.";
}

bool is_lit(DeviceState state, std::int64_t since_ns) {
  const std::string_view pattern = light_pattern(state);
  return pattern[static_cast<std::size_t>(since_ns / kStepNs) % pattern.size()] == '#';
}

Press Button::look(bool pressed, std::int64_t now_ns) {
  if (raw_since_ns_ < 0 || pressed != raw_) raw_since_ns_ = now_ns;
  raw_ = pressed;
  const bool steady = now_ns - raw_since_ns_ >= kBounceNs;
  if (steady && raw_ != pressed_) {
    pressed_ = raw_;
    if (pressed_) {
      pressed_since_ns_ = raw_since_ns_;
      told_ = false;
    } else if (!told_) {
      told_ = true;
      return Press::kShort;
    }
  }
  if (pressed_ && !told_ && now_ns - pressed_since_ns_ >= kLongNs) {
    told_ = true;
    return Press::kLong;
  }
  return Press::kNone;
}

}  // namespace lcdm
