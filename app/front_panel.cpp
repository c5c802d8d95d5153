#include "app/front_panel.h"

#include <cstdio>

#include "firmware/base/os.h"

namespace lcdm {
namespace {

// The heartbeat output changes its level this often: 2 Hz.
constexpr std::int64_t kHalfBeatNs = 250'000'000;
// Looks in a row at which a line may fail, as an expander on a disturbed bus does, before it is
// given up.
constexpr int kMostFailures = 10;

}  // namespace

FrontPanel::FrontPanel(const Config::Gpio& names)
    : light_(request("light", names.light, GpioUse::kOutput)),
      button_line_(request("button", names.button, GpioUse::kInput)),
      heartbeat_(request("heartbeat", names.heartbeat, GpioUse::kOutput)),
      state_since_ns_(os::monotonic_ns()) {
  drive(light_, true);  // booting
}

FrontPanel::Line FrontPanel::request(const char* key, const std::string& name, GpioUse use) {
  if (name.empty()) return {};
  Result<std::unique_ptr<GpioLine>> line = request_gpio_line(name, use);
  if (line) return {std::move(*line)};
  warnings_.push_back(std::string("gpio.") + key + ": " + line.status().text());
  std::fprintf(stderr, "lcdm: warning: %s; going on without\n", warnings_.back().c_str());
  return {};
}

Press FrontPanel::look(DeviceState state, bool alive, std::int64_t now_ns) {
  if (state != state_) state_since_ns_ = now_ns;
  state_ = state;
  drive(light_, is_lit(state, now_ns - state_since_ns_));
  drive(heartbeat_, alive && now_ns / kHalfBeatNs % 2 == 0);
  if (!button_line_.gpio) return Press::kNone;
  const Result<bool> pressed = button_line_.gpio->get();
  judge(button_line_, pressed.status());
  return pressed ? button_.look(*pressed, now_ns) : Press::kNone;
}

void FrontPanel::release() {
  for (Line* line : {&light_, &button_line_, &heartbeat_}) line->gpio.reset();
}

void FrontPanel::drive(Line& line, bool active) {
  if (line.gpio) judge(line, line.gpio->set(active));
}

// A line that goes on failing is a line less.
void FrontPanel::judge(Line& line, const Status& status) {
  line.failures = status ? 0 : line.failures + 1;
  if (line.failures < kMostFailures) return;
  warnings_.emplace_back(status.text());
  std::fprintf(stderr, "lcdm: warning: %s; going on without\n", status.text());
  line.gpio.reset();
}

}  // namespace lcdm
