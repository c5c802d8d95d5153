#include "app/page.h"

#include <algorithm>
#include <cstdio>
#include <utility>

#include "app/address.h"
#include "app/http_client.h"
#include "firmware/base/os.h"

namespace lcdm {
namespace {

using std::chrono::milliseconds;

constexpr milliseconds kPeriod{10'000};
constexpr milliseconds kPeriodOfAddresses{2'000};  // while one is missing
constexpr milliseconds kPauseAfterSilence{1'000};

}  // namespace

Result<std::unique_ptr<Page>> Page::start(const HttpOptions& options,
                                          const std::vector<HttpRoute>& routes) {
  std::unique_ptr<Page> page(new Page(options, routes));
  const Status served = page->serve();
  if (!served && served.code() != StatusCode::kNotFound) return served;
  for (const std::string& address : page->missing()) {
    std::printf("http.listen: this machine does not have %s now: waiting for it\n",
                address.c_str());
  }
  page->thread_ = std::thread([raw = page.get()] { raw->watch(); });
  return page;
}

void Page::stop() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
    if (server_) server_->stop();  // a question under way ends with it
  }
  stop_asked_.notify_all();
  if (thread_.joinable()) thread_.join();
  server_.reset();  // it may have been started again meanwhile
}

std::string Page::address() const {
  const std::lock_guard lock(mutex_);
  return server_ ? server_->address() : std::string();
}

// On the addresses that are there. kNotFound: none is.
Status Page::serve() {
  Result<std::unique_ptr<HttpServer>> server = HttpServer::start(options_, routes_);
  const std::lock_guard lock(mutex_);
  server_ = server ? std::move(*server) : nullptr;
  return server ? Status::ok() : server.status();
}

std::vector<std::string> Page::missing() const {
  return server_ ? server_->left_out() : options_.listen;
}

bool Page::arrived() const {
  const std::vector<std::string> addresses = missing();
  return std::any_of(addresses.begin(), addresses.end(), [this](const std::string& address) {
    return bind_error(address, options_.port) == 0;
  });
}

void Page::watch() {
  os::set_thread_name("page");
  do {
    if (arrived() && !serve_again()) continue;  // without rest: there is no page
    if (server_ && !ask()) return;
  } while (!stops_within(missing().empty() ? kPeriod : kPeriodOfAddresses));
}

// With the address that arrived; viewers ask again.
bool Page::serve_again() {
  heartbeat_.beat(os::monotonic_ns());
  std::vector<std::string> arrived = missing();
  {
    const std::lock_guard lock(mutex_);
    if (server_) server_->stop();
  }
  if (const Status served = serve(); !served) {
    std::fprintf(stderr, "lcdm: warning: %s\n", served.text());
    return false;
  }
  for (const std::string& address : missing()) std::erase(arrived, address);
  for (const std::string& address : arrived) {
    std::printf("http.listen: %s is there now\n", address.c_str());
  }
  std::printf("page    %s\n", server_->address().c_str());
  std::fflush(stdout);
  return true;
}

// Until it answers, whatever it says: it lives. Not where all its addresses have gone: then it
// cannot be asked. False when the page stops.
bool Page::ask() {
  heartbeat_.beat(os::monotonic_ns());
  while (true) {
    const std::string address = server_->local_address();
    if (address.empty() || http_get(address, server_->port(), "/healthz")) break;
    if (stops_within(kPauseAfterSilence)) return false;
  }
  heartbeat_.rest();
  return true;
}

bool Page::stops_within(milliseconds time) {
  std::unique_lock lock(mutex_);
  return stop_asked_.wait_for(lock, time, [this] { return stopping_; });
}

}  // namespace lcdm
