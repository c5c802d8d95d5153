// The HTTP server of the page, kept up for months: asked as any client would whether it still
// answers (a blocked pool of civetweb's threads, which have no heartbeats, must not stay unseen
// behind a green light), and started again when an address arrives that this machine lacked.
#pragma once

#include <chrono>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "app/http_server.h"
#include "firmware/health/heartbeat.h"

namespace lcdm {

// The owner's thread calls start and stop; `page` is its own and does the asking.
class Page {
 public:
  // Addresses that this machine does not have now are waited for, though it be all of them.
  // kUnavailable: the port is taken.
  static Result<std::unique_ptr<Page>> start(const HttpOptions& options,
                                             const std::vector<HttpRoute>& routes);
  ~Page() { stop(); }
  Page(const Page&) = delete;
  Page& operator=(const Page&) = delete;

  // Ends every connection, within the time-out of a question.
  void stop();

  // Where a browser finds it; empty while this machine has none of its addresses.
  std::string address() const;
  // Beats when the page is asked and rests once it has answered.
  const Heartbeat& heartbeat() const { return heartbeat_; }

 private:
  Page(const HttpOptions& options, const std::vector<HttpRoute>& routes)
      : options_(options), routes_(routes) {}

  Status serve();
  std::vector<std::string> missing() const;
  bool arrived() const;
  void watch();
  bool serve_again();
  bool ask();
  bool stops_within(std::chrono::milliseconds time);

  const HttpOptions options_;
  const std::vector<HttpRoute> routes_;
  Heartbeat heartbeat_;
  mutable std::mutex mutex_;  // guards what follows
  std::condition_variable stop_asked_;
  bool stopping_ = false;
  std::unique_ptr<HttpServer> server_;  // empty while there is no address; only `page` changes it
  std::thread thread_;                  // the owner's
};

}  // namespace lcdm
