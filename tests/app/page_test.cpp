// The heart of the page: a pool that answers lets it rest, one that does not lets it grow old.
#include "app/page_check.h"

#include <atomic>
#include <chrono>
#include <gtest/gtest.h>
#include <thread>

#include "app/http_server.h"
#include "firmware/base/os.h"

namespace lcdm {
namespace {

using std::chrono::milliseconds;

// `/healthz` waits for the test.
class PageCheckTest : public testing::Test {
 protected:
  void start(const char* listen) {
    const auto healthz = [this](HttpExchange& exchange) {
      ++asked_;
      while (blocked_) std::this_thread::sleep_for(milliseconds(5));
      exchange.send_text(503, "text/plain", "not well, but alive");
    };
    HttpOptions options;
    options.listen = {listen};
    auto server = HttpServer::start(options, {{"/healthz", "GET", HttpStay::kShort, healthz}});
    ASSERT_TRUE(server) << server.status().text();
    server_ = std::move(*server);
  }
  template <typename Condition>
  static bool eventually(Condition&& condition) {
    for (int i = 0; i < 12'000 && !condition(); ++i) std::this_thread::sleep_for(milliseconds(5));
    return condition();
  }
  static std::int64_t age_of(const PageCheck& check) {
    return check.heartbeat().age_ns(os::monotonic_ns());
  }

  std::atomic<int> asked_{0};
  std::atomic<bool> blocked_{false};
  std::unique_ptr<HttpServer> server_;
};

TEST_F(PageCheckTest, RestsOnceThePageHasAnswered) {
  for (const char* listen : {"127.0.0.1", "0.0.0.0"}) {
    start(listen);
    PageCheck check(server_->local_address(), server_->port());
    EXPECT_TRUE(eventually([&] { return asked_ > 0 && age_of(check) < 0; })) << listen;
    asked_ = 0;
  }
}

TEST_F(PageCheckTest, GrowsOldWhileThePageIsSilentAndAsksAgain) {
  start("127.0.0.1");
  blocked_ = true;
  PageCheck check(server_->local_address(), server_->port());
  EXPECT_TRUE(eventually([&] { return asked_ >= 2; }));
  EXPECT_GT(age_of(check), 2'000'000'000) << "since the first question";
  blocked_ = false;
  EXPECT_TRUE(eventually([&] { return age_of(check) < 0; }));
}

TEST_F(PageCheckTest, AnEndedServerDoesNotHoldUpTheStop) {
  start("127.0.0.1");
  PageCheck check(server_->local_address(), server_->port());
  server_->stop();
  const std::int64_t begin_ns = os::monotonic_ns();
  check.stop();
  EXPECT_LT(os::monotonic_ns() - begin_ns, 30'000'000'000);
}

}  // namespace
}  // namespace lcdm
