#include "app/page_check.h"

#include <chrono>
#include <utility>

#include "app/http_client.h"
#include "firmware/base/os.h"

namespace lcdm {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kPeriod{10'000};
constexpr milliseconds kPauseAfterSilence{1'000};

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
    while (!http_get(address_, port_, "/healthz")) {  // whatever it says, it lives
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
