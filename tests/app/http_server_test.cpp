// The HTTP server against clients that are slow, silent, too big or too many: each costs itself.
#include "app/http_server.h"

#include <arpa/inet.h>
#include <array>
#include <atomic>
#include <chrono>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <ifaddrs.h>
#include <memory>
#include <net/if.h>
#include <stdexcept>
#include <thread>
#include <vector>

#include "tests/app/raw_client.h"

namespace lcdm {
namespace {

using test::get;
using test::RawClient;
using test::request;
using testing::EndsWith;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

class HttpServerTest : public testing::Test {
 protected:
  void SetUp() override {
    HttpOptions options;
    options.listen = {"127.0.0.1"};
    options.max_clients = 2;
    options.timeout_ms = 500;
    auto started = HttpServer::start(options, routes());
    ASSERT_TRUE(started) << started.status().text();
    server_ = std::move(*started);
    port_ = server_->port();
  }

  std::vector<HttpRoute> routes() {
    return {
        {"/hello", "GET", HttpStay::kShort,
         [](HttpExchange& exchange) { exchange.send_text(200, "text/plain", "hello"); }},
        {"/viewers", "GET", HttpStay::kShort,
         [](HttpExchange& exchange) {
           exchange.send_text(200, "text/plain", std::to_string(exchange.viewers()));
         }},
        {"/query", "GET", HttpStay::kShort,
         [](HttpExchange& exchange) {
           exchange.send_text(200, "text/plain", exchange.query("q"));
         }},
        {"/change", "POST", HttpStay::kShort,
         [](HttpExchange& exchange) { exchange.send_text(200, "text/plain", "changed"); }},
        {"/throw", "GET", HttpStay::kShort,
         [](HttpExchange&) { throw std::runtime_error("a bug"); }},
        {"/flood", "GET", HttpStay::kStream, [this](HttpExchange& exchange) { flood(exchange); }},
        {"/wait", "GET", HttpStay::kWaits, [this](HttpExchange& exchange) { wait(exchange); }},
    };
  }

  // Answers when the test says so.
  void wait(HttpExchange& exchange) {
    ++waiting_;
    while (!come_) std::this_thread::sleep_for(std::chrono::milliseconds(10));
    exchange.send_text(200, "text/plain", "come");
  }

  // Sends as fast as the client takes it.
  void flood(HttpExchange& exchange) {
    const std::vector<std::byte> block(64 * 1024);
    bool open = exchange.begin_stream("application/octet-stream");
    while (open) open = exchange.write(block);
    ++floods_ended_;
  }

  // Waits until `count` floods have ended; false after `seconds`.
  bool wait_for_floods(int count, int seconds) const {
    for (int i = 0; i < seconds * 100 && floods_ended_ < count; ++i) {
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    return floods_ended_ >= count;
  }

  std::atomic<int> floods_ended_{0};
  std::atomic<int> waiting_{0};
  std::atomic<bool> come_{false};
  std::unique_ptr<HttpServer> server_;
  int port_ = 0;
};

void start_stream(RawClient& client) {
  client.send("GET /flood HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n");
}

TEST_F(HttpServerTest, AnswersWithItsSecurityHeaders) {
  const std::string answer = get(port_, "/hello");
  EXPECT_THAT(answer, StartsWith("HTTP/1.1 200 OK\r\n"));
  EXPECT_THAT(answer, EndsWith("\r\n\r\nhello"));
  EXPECT_THAT(answer, HasSubstr("Content-Length: 5\r\n"));
  EXPECT_THAT(answer, HasSubstr("Content-Security-Policy: default-src 'self'"));
  EXPECT_THAT(answer, HasSubstr("frame-ancestors 'none'"));
  EXPECT_THAT(answer, HasSubstr("X-Content-Type-Options: nosniff\r\n"));
  EXPECT_THAT(answer, Not(HasSubstr("Access-Control-Allow-Origin")));
}

TEST_F(HttpServerTest, ReadsTheQuery) {
  EXPECT_THAT(get(port_, "/query?q=a%20b"), EndsWith("\r\n\r\na b"));
  EXPECT_THAT(get(port_, "/query"), EndsWith("\r\n\r\n"));
  EXPECT_THAT(get(port_, "/query?q=" + std::string(200, 'x')),
              EndsWith("\r\n\r\n" + std::string(200, 'x')));
}

TEST_F(HttpServerTest, HeadHasNoBody) {
  const std::string answer = request(port_, "HEAD", "/hello");
  EXPECT_THAT(answer, HasSubstr("Content-Length: 5\r\n"));
  EXPECT_THAT(answer, EndsWith("\r\n\r\n"));
}

TEST_F(HttpServerTest, RefusesWhatTheGuardRefuses) {
  EXPECT_THAT(get(port_, "/nowhere"), StartsWith("HTTP/1.1 404 "));
  EXPECT_THAT(get(port_, "/../../etc/passwd"), StartsWith("HTTP/1.1 404 ")) << "no files at all";
  EXPECT_THAT(request(port_, "GET", "/hello", "Host: evil.example\r\n"),
              StartsWith("HTTP/1.1 421 "));
  EXPECT_THAT(request(port_, "GET", "/nowhere", "Host: evil.example\r\n"),
              StartsWith("HTTP/1.1 421 "));
  const std::string wrong_method = request(port_, "POST", "/hello");
  EXPECT_THAT(wrong_method, StartsWith("HTTP/1.1 405 "));
  EXPECT_THAT(wrong_method, HasSubstr("Allow: GET\r\n"));
}

TEST_F(HttpServerTest, ChangesStateOnlyForItsOwnPage) {
  const std::string ours = "Host: 127.0.0.1\r\nContent-Length: 0\r\n";
  EXPECT_THAT(request(port_, "POST", "/change", ours), EndsWith("changed"));
  EXPECT_THAT(request(port_, "POST", "/change", ours + "Origin: http://evil.example\r\n"),
              StartsWith("HTTP/1.1 403 "));
  EXPECT_THAT(get(port_, "/change"), StartsWith("HTTP/1.1 405 "));
}

// The first address of this machine that others see; empty when it has none.
std::string outside_address() {
  ifaddrs* all = nullptr;
  if (getifaddrs(&all) != 0) return {};
  std::string found;
  for (const ifaddrs* each = all; each != nullptr && found.empty(); each = each->ifa_next) {
    if (each->ifa_addr == nullptr || each->ifa_addr->sa_family != AF_INET) continue;
    if ((each->ifa_flags & IFF_LOOPBACK) != 0) continue;
    char text[INET_ADDRSTRLEN] = {};
    inet_ntop(AF_INET, &reinterpret_cast<const sockaddr_in*>(each->ifa_addr)->sin_addr, text,
              sizeof(text));
    found = text;
  }
  freeifaddrs(all);
  return found;
}

TEST_F(HttpServerTest, FromOutsideControlNeedsTheToken) {
  const std::string outside = outside_address();
  if (outside.empty()) GTEST_SKIP() << "this machine has no address but loopback";
  HttpOptions options;
  options.listen = {outside};
  options.token = "0123456789abcdef";
  const auto server = HttpServer::start(options, routes());
  ASSERT_TRUE(server) << server.status().text();
  const auto post = [&](const std::string& more) {
    RawClient client((*server)->port(), outside);
    client.send("POST /change HTTP/1.1\r\nHost: " + outside + "\r\nContent-Length: 0\r\n" + more +
                "\r\n");
    return client.read(5000);
  };
  const std::string refused = post("");
  EXPECT_THAT(refused, StartsWith("HTTP/1.1 401 "));
  EXPECT_THAT(refused, HasSubstr("WWW-Authenticate: Bearer\r\n"));
  EXPECT_THAT(refused, Not(HasSubstr(options.token)));
  EXPECT_THAT(post("Authorization: Bearer 0123456789abcdeX\r\n"), StartsWith("HTTP/1.1 401 "));
  EXPECT_THAT(post("Authorization: Bearer 0123456789abcdef\r\n"), EndsWith("changed"));
  RawClient looking((*server)->port(), outside);
  looking.send("GET /hello HTTP/1.1\r\nHost: " + outside + "\r\n\r\n");
  EXPECT_THAT(looking.read(5000), EndsWith("hello")) << "looking needs none";
}

TEST_F(HttpServerTest, AnAddressThatTheMachineLacksIsLeftOut) {
  server_->stop();
  HttpOptions options;
  options.listen = {"192.0.2.77", "127.0.0.1"};  // the first is nobody's, by its standard
  options.port = port_;
  const auto server = HttpServer::start(options, routes());
  ASSERT_TRUE(server) << server.status().text();
  EXPECT_EQ((*server)->left_out(), std::vector<std::string>{"192.0.2.77"});
  EXPECT_THAT(get(port_, "/hello"), EndsWith("hello"));
}

TEST_F(HttpServerTest, ServesEveryAddressItIsGiven) {
  server_->stop();
  HttpOptions options;
  options.listen = {"127.0.0.1", "127.0.0.2"};
  options.port = port_;
  const auto server = HttpServer::start(options, routes());
  ASSERT_TRUE(server) << server.status().text();
  for (const char* address : {"127.0.0.1", "127.0.0.2"}) {
    RawClient client(port_, address);
    client.send("GET /hello HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n");
    EXPECT_THAT(client.read(5000), EndsWith("hello")) << address;
  }
  EXPECT_TRUE((*server)->left_out().empty());
}

TEST_F(HttpServerTest, AFaultInAHandlerIsAnAnswer) {
  EXPECT_THAT(get(port_, "/throw"), StartsWith("HTTP/1.1 500 "));
  EXPECT_THAT(get(port_, "/hello"), EndsWith("hello"));
}

TEST_F(HttpServerTest, AnOversizedRequestIsRefused) {
  const std::string huge = "Host: 127.0.0.1\r\nX-Big: " + std::string(20000, 'x') + "\r\n";
  EXPECT_THAT(request(port_, "GET", "/hello", huge), Not(HasSubstr("hello")));
  EXPECT_THAT(get(port_, "/hello"), EndsWith("hello"));
}

TEST_F(HttpServerTest, GarbageIsNotARequest) {
  RawClient client(port_);
  client.send(std::string("\x16\x03\x01\x00\xff\x00garbage\r\n\r\n", 17));
  EXPECT_THAT(client.read(2000), Not(HasSubstr("200 OK")));
  EXPECT_THAT(get(port_, "/hello"), EndsWith("hello"));
}

// As browsers open in advance.
TEST_F(HttpServerTest, ConnectionsThatSayNothingTakeNoThreads) {
  HttpOptions options;
  options.listen = {"127.0.0.1"};
  options.timeout_ms = 20'000;
  const auto server = HttpServer::start(options, routes());
  ASSERT_TRUE(server) << server.status().text();
  const int port = (*server)->port();
  std::vector<std::unique_ptr<RawClient>> silent;
  for (int i = 0; i < 32; ++i) silent.push_back(std::make_unique<RawClient>(port));
  std::this_thread::sleep_for(std::chrono::milliseconds(200));  // a thread would have them by now
  EXPECT_THAT(get(port, "/hello"), EndsWith("hello"));
  silent.back()->send("GET /hello HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n");
  EXPECT_THAT(silent.back()->read(5000), EndsWith("hello")) << "when it speaks it is served";
}

TEST_F(HttpServerTest, ClientsThatStopAmidTheirRequestDoNotKeepOthersOut) {
  std::vector<std::unique_ptr<RawClient>> silent;
  for (int i = 0; i < 16; ++i) silent.push_back(std::make_unique<RawClient>(port_));
  for (const auto& client : silent) client->send("GET /hel");
  EXPECT_THAT(request(port_, "GET", "/hello", "Host: 127.0.0.1\r\n", 15000), EndsWith("hello"));
}

TEST_F(HttpServerTest, ClientsWhoseAnnouncedBodyNeverComesDoNotKeepOthersOut) {
  std::vector<std::unique_ptr<RawClient>> clients;
  for (int i = 0; i < 16; ++i) clients.push_back(std::make_unique<RawClient>(port_));
  std::atomic<bool> stop{false};
  for (const auto& client : clients) {
    client->send("GET /hello HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1000000000\r\n\r\n");
  }
  std::thread drip([&] {
    while (!stop) {
      for (const auto& client : clients) client->send("x");
      std::this_thread::sleep_for(std::chrono::milliseconds(200));
    }
  });
  EXPECT_THAT(request(port_, "GET", "/hello", "Host: 127.0.0.1\r\n", 15000), EndsWith("hello"));
  stop = true;
  drip.join();
}

TEST_F(HttpServerTest, AStalledViewerCostsOnlyItself) {
  RawClient stalled(port_);
  start_stream(stalled);
  RawClient reading(port_);
  start_stream(reading);
  EXPECT_GT(reading.read(1000, 8 << 20).size(), 4U << 20) << "the other viewer is served";
  EXPECT_THAT(get(port_, "/hello"), EndsWith("hello"));
  // The stalled one is dropped, although its connection is open; the reading one goes on.
  std::thread reader([&] { reading.read(8000); });
  EXPECT_TRUE(wait_for_floods(1, 7));
  EXPECT_THAT(get(port_, "/viewers"), EndsWith("\r\n\r\n1"));
  server_->stop();
  reader.join();
}

TEST_F(HttpServerTest, OneViewerTooManyIsTurnedAway) {
  std::array<std::unique_ptr<RawClient>, 2> viewers;
  for (auto& viewer : viewers) {
    viewer = std::make_unique<RawClient>(port_);
    start_stream(*viewer);
    EXPECT_THAT(viewer->read(2000, 100), StartsWith("HTTP/1.1 200 "));
  }
  const std::string answer = get(port_, "/flood");
  EXPECT_THAT(answer, StartsWith("HTTP/1.1 503 "));
  EXPECT_THAT(answer, HasSubstr("http.max_clients"));
  viewers[0].reset();
  ASSERT_TRUE(wait_for_floods(1, 5));
  RawClient next(port_);
  start_stream(next);
  EXPECT_THAT(next.read(2000, 100), StartsWith("HTTP/1.1 200 ")) << "a place is free again";
}

TEST_F(HttpServerTest, ThoseWhoWaitNeverTakeTheThreadsOfShortRequests) {
  constexpr int kMayWait = 4;
  std::vector<std::thread> clients;
  std::atomic<int> served{0};
  for (int i = 0; i < kMayWait; ++i) {
    clients.emplace_back([&] { served += get(port_, "/wait").ends_with("come") ? 1 : 0; });
  }
  for (int i = 0; i < 500 && waiting_ < kMayWait; ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  EXPECT_EQ(waiting_, kMayWait);
  const std::string answer = get(port_, "/wait");
  EXPECT_THAT(answer, StartsWith("HTTP/1.1 503 "));
  EXPECT_THAT(answer, HasSubstr("Retry-After: 1"));
  EXPECT_THAT(get(port_, "/hello"), EndsWith("hello"));
  come_ = true;
  for (std::thread& client : clients) client.join();
  EXPECT_EQ(served, kMayWait);
  EXPECT_THAT(get(port_, "/wait"), EndsWith("come")) << "a place is free again";
}

TEST_F(HttpServerTest, StopsWithoutWaitingForItsClients) {
  RawClient silent(port_);
  RawClient stalled(port_);
  start_stream(stalled);
  EXPECT_FALSE(stalled.read(2000, 100).empty());
  std::this_thread::sleep_for(std::chrono::milliseconds(200));  // let its buffers fill
  const auto begin = std::chrono::steady_clock::now();
  server_->stop();
  EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(5));
  EXPECT_FALSE(RawClient(port_).connected());
}

TEST_F(HttpServerTest, ATakenPortIsSaidSo) {
  HttpOptions options;
  options.listen = {"127.0.0.1"};
  options.port = port_;
  const auto second = HttpServer::start(options, {});
  ASSERT_FALSE(second);
  const std::string text = second.status().text();
  EXPECT_THAT(text, HasSubstr("127.0.0.1:" + std::to_string(port_)));
  EXPECT_THAT(text, HasSubstr("--port"));
  EXPECT_EQ(text.find('\n'), std::string::npos);
}

}  // namespace
}  // namespace lcdm
