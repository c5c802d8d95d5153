// The service manager's end of sd_notify: a datagram socket like the one systemd makes.
#pragma once

#include <cstdio>
#include <poll.h>
#include <string>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "firmware/base/check.h"

namespace lcdm::test {

class NotifySocket {
 public:
  // `path`: of the socket, short enough for an address.
  explicit NotifySocket(const std::string& path)
      : path_(path), socket_(socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0)) {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    LCDM_CHECK(path.size() < sizeof(address.sun_path));
    path.copy(address.sun_path, path.size());
    unlink(path.c_str());
    LCDM_CHECK(bind(socket_, reinterpret_cast<sockaddr*>(&address), sizeof(address)) == 0);
  }
  ~NotifySocket() {
    close(socket_);
    unlink(path_.c_str());
  }
  NotifySocket(const NotifySocket&) = delete;
  NotifySocket& operator=(const NotifySocket&) = delete;

  const std::string& path() const { return path_; }

  // The next message; empty when none came within `timeout_ms`.
  std::string next(int timeout_ms = 5000) {
    pollfd waiting{socket_, POLLIN, 0};
    if (poll(&waiting, 1, timeout_ms) <= 0) return {};
    char buffer[4096];
    const auto got = recv(socket_, buffer, sizeof(buffer), 0);
    return got <= 0 ? std::string() : std::string(buffer, static_cast<std::size_t>(got));
  }

 private:
  const std::string path_;
  int socket_;
};

}  // namespace lcdm::test
