#include "app/http_client.h"

#include <array>
#include <cstddef>
#include <memory>
#include <netdb.h>
#include <sys/socket.h>
#include <unistd.h>

namespace lcdm {
namespace {

constexpr timeval kTimeout{2, 0};
constexpr std::size_t kMostBytes = 1 << 20;

// Everything until the server closes; empty: it did not answer.
std::string ask(int socket, const addrinfo& place, const std::string& question) {
  setsockopt(socket, SOL_SOCKET, SO_SNDTIMEO, &kTimeout, sizeof(kTimeout));
  setsockopt(socket, SOL_SOCKET, SO_RCVTIMEO, &kTimeout, sizeof(kTimeout));
  if (connect(socket, place.ai_addr, place.ai_addrlen) != 0) return "";
  if (send(socket, question.data(), question.size(), MSG_NOSIGNAL) < 0) return "";
  std::string answer;
  std::array<char, 4096> part{};
  while (answer.size() < kMostBytes) {
    const ssize_t got = recv(socket, part.data(), part.size(), 0);
    if (got <= 0) break;
    answer.append(part.data(), static_cast<std::size_t>(got));
  }
  return answer;
}

}  // namespace

std::optional<std::string> http_get(const std::string& address, int port, const std::string& path) {
  addrinfo hints{};
  hints.ai_flags = AI_NUMERICHOST | AI_NUMERICSERV;
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  const std::string service = std::to_string(port);
  if (getaddrinfo(address.c_str(), service.c_str(), &hints, &found) != 0) return std::nullopt;
  const std::unique_ptr<addrinfo, decltype(&freeaddrinfo)> place(found, &freeaddrinfo);
  const int connection = socket(place->ai_family, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (connection < 0) return std::nullopt;
  const std::string answer =
      ask(connection, *place, "GET " + path + " HTTP/1.0\r\nHost: localhost\r\n\r\n");
  close(connection);
  const std::size_t head = answer.find("\r\n\r\n");
  if (head == std::string::npos) return std::nullopt;
  return answer.substr(head + 4);
}

}  // namespace lcdm
