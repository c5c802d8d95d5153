// The page for months: a server that answers lets its heart rest, one that does not lets it grow
// old, and an address that arrives is served.
#include "app/page.h"

#include <arpa/inet.h>
#include <atomic>
#include <chrono>
#include <gtest/gtest.h>
#include <net/if.h>
#include <netinet/in.h>
#include <sched.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <thread>
#include <unistd.h>

#include "app/http_client.h"
#include "firmware/base/os.h"

namespace lcdm {
namespace {

using std::chrono::milliseconds;

template <typename Condition>
bool eventually(Condition&& condition) {
  for (int i = 0; i < 12'000 && !condition(); ++i) std::this_thread::sleep_for(milliseconds(5));
  return condition();
}

// `/healthz` waits for the test.
class PageTest : public testing::Test {
 protected:
  void start(const char* listen, int port = 0) {
    const auto healthz = [this](HttpExchange& exchange) {
      ++asked_;
      while (blocked_) std::this_thread::sleep_for(milliseconds(5));
      exchange.send_text(503, "text/plain", "not well, but alive");
    };
    HttpOptions options;
    options.listen = {listen};
    options.port = port;
    auto page = Page::start(options, {{"/healthz", "GET", HttpStay::kShort, healthz}});
    ASSERT_TRUE(page) << page.status().text();
    page_ = std::move(*page);
  }
  std::int64_t age() const { return page_->heartbeat().age_ns(os::monotonic_ns()); }

  std::atomic<int> asked_{0};
  std::atomic<bool> blocked_{false};
  std::unique_ptr<Page> page_;
};

TEST_F(PageTest, RestsOnceItHasAnswered) {
  for (const char* listen : {"127.0.0.1", "0.0.0.0"}) {
    start(listen);
    EXPECT_TRUE(eventually([&] { return asked_ > 0 && age() < 0; })) << listen;
    asked_ = 0;
  }
}

TEST_F(PageTest, GrowsOldWhileItIsSilentAndIsAskedAgain) {
  blocked_ = true;
  start("127.0.0.1");
  EXPECT_TRUE(eventually([&] { return asked_ >= 2; }));
  EXPECT_GT(age(), 2'000'000'000) << "since the first question";
  blocked_ = false;
  EXPECT_TRUE(eventually([&] { return age() < 0; }));
}

TEST_F(PageTest, RefusesAPortThatIsTaken) {
  start("127.0.0.1");
  const std::string address = page_->address();
  HttpOptions options;
  options.listen = {"127.0.0.1"};
  options.port = std::stoi(address.substr(address.rfind(':') + 1));
  EXPECT_EQ(Page::start(options, {}).code(), StatusCode::kUnavailable);
}

// Gives this network's loopback the address.
void add_address(const char* address) {
  ifreq request{};
  std::snprintf(request.ifr_name, sizeof(request.ifr_name), "lo");
  const int control = socket(AF_INET, SOCK_DGRAM, 0);
  auto* wanted = reinterpret_cast<sockaddr_in*>(&request.ifr_addr);
  *wanted = {};
  wanted->sin_family = AF_INET;
  inet_pton(AF_INET, address, &wanted->sin_addr);
  EXPECT_EQ(ioctl(control, SIOCSIFADDR, &request), 0);
  request.ifr_flags = IFF_UP;
  EXPECT_EQ(ioctl(control, SIOCSIFFLAGS, &request), 0);
  close(control);
}

// In a network of its own, whose loopback changes its address.
TEST_F(PageTest, WaitsForAnAddressThatTheMachineDoesNotHaveYet) {
  constexpr const char* kLater = "10.77.0.1";
  bool alone = false;
  std::thread elsewhere([&] {
    alone = unshare(CLONE_NEWNET) == 0;
    if (!alone) return;
    add_address("127.0.0.1");  // before the first one any could be bound
    start(kLater, 8080);
    EXPECT_EQ(page_->address(), "");
    EXPECT_LT(age(), 0) << "nothing is late";
    add_address(kLater);
    EXPECT_TRUE(eventually([&] { return asked_ > 0 && age() < 0; }));
    EXPECT_EQ(page_->address(), "http://10.77.0.1:8080/");
    EXPECT_EQ(http_get(kLater, 8080, "/healthz"), "not well, but alive");
    page_->stop();
  });
  elsewhere.join();
  if (!alone) GTEST_SKIP() << "only root may have a network of its own";
}

}  // namespace
}  // namespace lcdm
