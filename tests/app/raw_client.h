// A client that speaks to a port of this machine byte by byte, so that tests can be slow, silent or
// wrong on purpose.
#pragma once

#include <arpa/inet.h>
#include <cstdint>
#include <netinet/in.h>
#include <poll.h>
#include <string>
#include <string_view>
#include <sys/socket.h>
#include <unistd.h>

#include "firmware/base/check.h"
#include "firmware/base/os.h"

namespace lcdm::test {

class RawClient {
 public:
  explicit RawClient(int port, const std::string& host = "127.0.0.1")
      : socket_(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(port));
    inet_pton(AF_INET, host.c_str(), &address.sin_addr);
    connected_ = connect(socket_, reinterpret_cast<sockaddr*>(&address), sizeof(address)) == 0;
  }
  ~RawClient() { close(socket_); }
  RawClient(const RawClient&) = delete;
  RawClient& operator=(const RawClient&) = delete;

  bool connected() const { return connected_; }

  void send(std::string_view bytes) {
    [[maybe_unused]] const auto sent = ::send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL);
  }

  // Everything until the server closes, or until `bytes` have come, or until the time is over.
  std::string read(int timeout_ms, std::size_t bytes = SIZE_MAX) {
    std::string all;
    const std::int64_t end = os::monotonic_ns() + timeout_ms * 1'000'000LL;
    while (all.size() < bytes) {
      pollfd waiting{socket_, POLLIN, 0};
      const auto left = static_cast<int>((end - os::monotonic_ns()) / 1'000'000);
      if (left <= 0 || poll(&waiting, 1, left) <= 0) break;
      char buffer[16384];
      const auto got = recv(socket_, buffer, sizeof(buffer), 0);
      if (got <= 0) break;
      all.append(buffer, static_cast<std::size_t>(got));
    }
    return all;
  }

 private:
  int socket_;
  bool connected_ = false;
};

// One whole request and its answer.
inline std::string request(int port, const std::string& method, const std::string& path,
                           const std::string& headers = "Host: 127.0.0.1\r\n",
                           int timeout_ms = 5000) {
  RawClient client(port);
  client.send(method + " " + path + " HTTP/1.1\r\n" + headers + "\r\n");
  return client.read(timeout_ms);
}

inline std::string get(int port, const std::string& path) { return request(port, "GET", path); }

}  // namespace lcdm::test
