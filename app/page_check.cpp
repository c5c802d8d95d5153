#include "app/page_check.h"

#include <chrono>
#include <memory>
#include <netdb.h>
#include <string_view>
#include <sys/socket.h>
#include <unistd.h>
#include <utility>

#include "firmware/base/os.h"

namespace lcdm {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kPeriod{10'000};
constexpr milliseconds kPauseAfterSilence{1'000};
constexpr timeval kTimeout{2, 0};  // for each of connecting, sending and the first byte

bool ask(int socket, const addrinfo& place) {
  constexpr std::string_view kQuestion = "HEAD /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n";
  setsockopt(socket, SOL_SOCKET, SO_SNDTIMEO, &kTimeout, sizeof(kTimeout));
  setsockopt(socket, SOL_SOCKET, SO_RCVTIMEO, &kTimeout, sizeof(kTimeout));
  if (connect(socket, place.ai_addr, place.ai_addrlen) != 0) return false;
  if (send(socket, kQuestion.data(), kQuestion.size(), MSG_NOSIGNAL) < 0) return false;
  char first = 0;
  return recv(socket, &first, 1, 0) == 1;  // whatever it says, it lives
}

bool answers(const std::string& address, int port) {
  addrinfo hints{};
  hints.ai_flags = AI_NUMERICHOST | AI_NUMERICSERV;
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  if (getaddrinfo(address.c_str(), std::to_string(port).c_str(), &hints, &found) != 0) return false;
  const std::unique_ptr<addrinfo, decltype(&freeaddrinfo)> place(found, &freeaddrinfo);
  const int connection = socket(place->ai_family, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (connection < 0) return false;
  const bool answered = ask(connection, *place);
  close(connection);
  return answered;
}

}  // namespace

PageCheck::PageCheck(std::string address, int port)
    : address_(std::move(address)), port_(port), thread_([this] { run(); }) {}

void PageCheck::stop() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
  }
  stop_asked_.notify_all();
  if (thread_.joinable()) thread_.join();
}

void PageCheck::run() {
  os::set_thread_name("page");
  do {
    heartbeat_.beat(os::monotonic_ns());
    while (!answers(address_, port_)) {
      if (stops_within(kPauseAfterSilence)) return;
    }
    heartbeat_.rest();
  } while (!stops_within(kPeriod));
}

bool PageCheck::stops_within(milliseconds time) {
  std::unique_lock lock(mutex_);
  return stop_asked_.wait_for(lock, time, [this] { return stopping_; });
}

}  // namespace lcdm
