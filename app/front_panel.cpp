#include "app/front_panel.h"

#include <cstdio>

#include "firmware/base/os.h"

namespace lcdm {
namespace {

// The heartbeat output changes its level this often: 2 Hz.
constexpr std::int64_t kHalfBeatNs = 250'000'000;

}  // namespace

FrontPanel::FrontPanel(const Config::Gpio& names)
    : light_(request("light", names.light, GpioUse::kOutput)),
      button_line_(request("button", names.button, GpioUse::kInput)),
      heartbeat_(request("heartbeat", names.heartbeat, GpioUse::kOutput)),
      state_since_ns_(os::monotonic_ns()) {
  drive(light_, true);  // booting
}

FrontPanel::LinePtr FrontPanel::request(const char* key, const std::string& name, GpioUse use) {
  if (name.empty()) return nullptr;
  Result<LinePtr> line = request_gpio_line(name, use);
  if (line) return std::move(*line);
  warnings_.push_back(std::string("gpio.") + key + ": " + line.status().text());
  std::fprintf(stderr, "lcdm: warning: %s; going on without\n", warnings_.back().c_str());
  return nullptr;
}

Press FrontPanel::look(DeviceState state, bool alive, std::int64_t now_ns) {
  if (state != state_) state_since_ns_ = now_ns;
  state_ = state;
  drive(light_, is_lit(state, now_ns - state_since_ns_));
  drive(heartbeat_, alive && now_ns / kHalfBeatNs % 2 == 0);
  if (!button_line_) return Press::kNone;
  const Result<bool> pressed = button_line_->get();
  if (pressed) return button_.look(*pressed, now_ns);
  give_up(button_line_, pressed.status());
  return Press::kNone;
}

void FrontPanel::release() {
  light_.reset();
  button_line_.reset();
  heartbeat_.reset();
}

void FrontPanel::drive(LinePtr& line, bool active) {
  if (!line) return;
  const Status status = line->set(active);
  if (!status) give_up(line, status);
}

// A line that fails is a line less.
void FrontPanel::give_up(LinePtr& line, const Status& why) {
  warnings_.emplace_back(why.text());
  std::fprintf(stderr, "lcdm: warning: %s; going on without\n", why.text());
  line.reset();
}

}  // namespace lcdm
