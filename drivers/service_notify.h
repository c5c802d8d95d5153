// What a service tells systemd (sd_notify): that it is ready, what it does, that it lives.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

namespace lcdm {

// Nothing is sent where nobody listens: outside systemd every call does nothing. Belongs to one
// thread, which waits while systemd is too busy to take a message.
class ServiceNotify {
 public:
  // Reads the environment: NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID.
  ServiceNotify();

  // Whether somebody listens.
  bool listened() const { return listened_; }
  // Nanoseconds without a ping after which systemd ends and restarts us; 0: no watchdog.
  std::int64_t watchdog_ns() const { return watchdog_ns_; }

  // Each with one line for a person, as `systemctl status` shows it. Bytes that systemd would
  // refuse (control characters, anything beyond ASCII) are replaced.
  void ready(std::string_view status) const;
  void status(std::string_view status) const;
  void stopping(std::string_view status) const;
  // We live. Send it at half of watchdog_ns().
  void ping() const;

 private:
  void send(const std::string& message) const;

  bool listened_ = false;
  std::int64_t watchdog_ns_ = 0;
};

}  // namespace lcdm
