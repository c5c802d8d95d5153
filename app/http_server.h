// HTTP by civetweb: a capped pool of threads, time-outs, and the guard in front of every route.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "firmware/base/status.h"

struct mg_connection;
struct mg_context;

namespace lcdm {

using HttpHeaders = std::vector<std::pair<std::string, std::string>>;

// One request and its answer; lives on a thread of the server's pool for as long as its handler.
class HttpExchange {
 public:
  HttpExchange(mg_connection* connection, const std::atomic<bool>& stopping,
               const std::atomic<int>& viewers)
      : connection_(connection), stopping_(stopping), viewers_(viewers) {}

  // Whether an answer has begun: another one would be read as its body.
  bool begun() const { return begun_; }
  // How many streams the server runs now.
  int viewers() const { return viewers_.load(); }

  // The value of a query parameter, or empty.
  std::string query(const char* name) const;

  // The whole answer. The body is left out for HEAD.
  void send(int status, std::string_view type, std::span<const std::byte> body,
            const HttpHeaders& headers = {});
  void send_text(int status, std::string_view type, std::string_view body,
                 const HttpHeaders& headers = {});

  // An answer without an end: this, then write() until it says false (the client has gone, has
  // stalled for longer than the time-out, or the server stops).
  bool begin_stream(std::string_view type);
  bool write(std::span<const std::byte> bytes);
  bool write_text(std::string_view text);

 private:
  bool send_head(int status, std::string_view type, long long length, const HttpHeaders& headers);
  bool is_head_request() const;

  mg_connection* connection_;
  const std::atomic<bool>& stopping_;
  const std::atomic<int>& viewers_;
  bool begun_ = false;
};

// How long a route keeps its thread of the pool.
enum class HttpStay : std::uint8_t {
  kShort,   // answers with what is there
  kWaits,   // may wait for something: so many of these at once that half of the pool that short
            // requests have stays free
  kStream,  // for as long as the client reads: counts against max_clients
};

struct HttpRoute {
  std::string path;            // exact
  std::string method = "GET";  // anything that changes state is POST
  HttpStay stay = HttpStay::kShort;
  std::function<void(HttpExchange&)> serve;
};

struct HttpOptions {
  std::vector<std::string> listen;  // numeric addresses
  int port = 0;                     // 0: a free one; with one address only
  std::string token;      // what control from the network must carry; empty: none is taken
  bool insecure = false;  // everybody may control
  int max_clients = 8;
  int timeout_ms = 3000;  // a client may keep us waiting this long for its bytes or its reading
};

// Threads: start and stop belong to the owner; routes run on the pool's threads, several at once.
class HttpServer {
 public:
  // kNotFound: this machine has none of the addresses now; kUnavailable: the port is taken.
  static Result<std::unique_ptr<HttpServer>> start(const HttpOptions& options,
                                                   std::vector<HttpRoute> routes);
  ~HttpServer() { stop(); }
  HttpServer(const HttpServer&) = delete;
  HttpServer& operator=(const HttpServer&) = delete;

  // The addresses that this machine does not have (now): they were left out.
  const std::vector<std::string>& left_out() const { return left_out_; }

  // Ends every connection and joins the pool, within about a second.
  void stop();

  // Where a browser finds us, e.g. http://127.0.0.1:8080/
  std::string address() const;
  int port() const { return port_; }
  // The address, a number, at which this machine itself reaches it; empty: all have gone.
  std::string local_address() const;

 private:
  HttpServer(HttpOptions options, std::vector<HttpRoute> routes);
  Status listen();
  void tune_sockets() const;
  static void* begin_thread(const mg_context* context, int kind);
  static int begin_request(mg_connection* connection);
  static int log_message(const mg_connection* connection, const char* text);
  void handle(mg_connection* connection);
  void answer(mg_connection* connection, HttpExchange& exchange);
  const HttpRoute* find_route(const std::string& path, std::string_view method) const;
  void serve(const HttpRoute& route, HttpExchange& exchange);

  HttpOptions options_;
  const std::vector<HttpRoute> routes_;
  std::vector<std::string> left_out_;
  std::string machine_name_;
  std::atomic<bool> starting_{false};
  std::mutex complaint_mutex_;
  std::string last_complaint_;  // of the library, while starting; under complaint_mutex_
  mg_context* context_ = nullptr;
  int port_ = 0;
  std::atomic<int> viewers_{0};
  std::atomic<int> waiting_{0};
  std::atomic<bool> stopping_{false};
};

}  // namespace lcdm
