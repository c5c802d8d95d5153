#include "drivers/service_notify.h"

#include <algorithm>
#include <cstdlib>
#include <systemd/sd-daemon.h>

namespace lcdm {
namespace {

std::string status_line(std::string_view text) {
  std::string line = "STATUS=" + std::string(text);
  std::replace_if(
      line.begin(), line.end(), [](char c) { return c < ' ' || c > '~'; }, '?');
  return line;
}

}  // namespace

ServiceNotify::ServiceNotify() {
  const char* socket = std::getenv("NOTIFY_SOCKET");  // NOLINT(concurrency-mt-unsafe): read only
  listened_ = socket != nullptr && socket[0] != 0;
  std::uint64_t microseconds = 0;
  if (listened_ && sd_watchdog_enabled(0, &microseconds) > 0) {
    watchdog_ns_ = static_cast<std::int64_t>(microseconds) * 1000;
  }
}

void ServiceNotify::ready(std::string_view status) const {
  send("READY=1\n" + status_line(status));
}

void ServiceNotify::status(std::string_view status) const { send(status_line(status)); }

void ServiceNotify::stopping(std::string_view status) const {
  send("STOPPING=1\n" + status_line(status));
}

void ServiceNotify::ping() const { send("WATCHDOG=1"); }

// A message that does not arrive is systemd's loss: the watchdog's time-out is made for that.
void ServiceNotify::send(const std::string& message) const {
  if (listened_) static_cast<void>(sd_notify(0, message.c_str()));
}

}  // namespace lcdm
