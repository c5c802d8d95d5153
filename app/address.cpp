#include "app/address.h"

#include <arpa/inet.h>
#include <cerrno>
#include <civetweb.h>
#include <cstdint>
#include <optional>
#include <sys/socket.h>
#include <unistd.h>

namespace lcdm {
namespace {

struct SocketAddress {
  sockaddr_storage storage{};
  socklen_t length = 0;
};

std::optional<SocketAddress> parse(const std::string& text, int port) {
  SocketAddress address;
  auto* v4 = reinterpret_cast<sockaddr_in*>(&address.storage);
  if (inet_pton(AF_INET, text.c_str(), &v4->sin_addr) == 1) {
    v4->sin_family = AF_INET;
    v4->sin_port = htons(static_cast<std::uint16_t>(port));
    address.length = sizeof(*v4);
    return address;
  }
  auto* v6 = reinterpret_cast<sockaddr_in6*>(&address.storage);
  if (inet_pton(AF_INET6, text.c_str(), &v6->sin6_addr) != 1) return std::nullopt;
  v6->sin6_family = AF_INET6;
  v6->sin6_port = htons(static_cast<std::uint16_t>(port));
  address.length = sizeof(*v6);
  return address;
}

}  // namespace

bool is_numeric_address(const std::string& text) { return parse(text, 0).has_value(); }

std::string reachable_address(const std::string& listen) {
  if (listen == "0.0.0.0") return "127.0.0.1";
  return listen == "::" ? "::1" : listen;
}

int bind_error(const std::string& address, int port) {
  const auto parsed = parse(address, port);
  if (!parsed) return EINVAL;
  if (parsed->storage.ss_family == AF_INET6 && mg_check_feature(MG_FEATURES_IPV6) == 0) {
    return EAFNOSUPPORT;
  }
  const int fd = socket(parsed->storage.ss_family, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (fd < 0) return errno;
  const int yes = 1;
  setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof(yes));
  const auto* where = reinterpret_cast<const sockaddr*>(&parsed->storage);
  const int error = bind(fd, where, parsed->length) == 0 ? 0 : errno;
  close(fd);
  return error;
}

}  // namespace lcdm
