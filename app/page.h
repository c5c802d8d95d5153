// Whether the page still answers, asked as any client would: the HTTP library's threads have no
// heartbeats, and a blocked pool must not stay unseen behind a green light.
#pragma once

#include <chrono>
#include <condition_variable>
#include <mutex>
#include <string>
#include <thread>

#include "firmware/health/heartbeat.h"

namespace lcdm {

// The owner's thread calls the constructor and stop; `page` is its own and does the asking.
class PageCheck {
 public:
  // `address` is a number, of this machine.
  PageCheck(std::string address, int port);
  ~PageCheck() { stop(); }
  PageCheck(const PageCheck&) = delete;
  PageCheck& operator=(const PageCheck&) = delete;

  // Within the time-out of a question; at once when the server has ended.
  void stop();

  // Beats when the page is asked and rests once it has answered.
  const Heartbeat& heartbeat() const { return heartbeat_; }

 private:
  void run();
  bool stops_within(std::chrono::milliseconds time);

  const std::string address_;
  const int port_;
  Heartbeat heartbeat_;
  std::mutex mutex_;  // guards stopping_
  std::condition_variable stop_asked_;
  bool stopping_ = false;
  std::thread thread_;
};

}  // namespace lcdm
