// SIGINT, SIGTERM and SIGHUP (the terminal was closed), taken by the main thread alone and when it
// asks. One that is ignored at the start, as SIGHUP under nohup, stays so.
//
// They are blocked there and in every thread it makes. A library may have made threads before main
// (OpenBLAS does), which do not block them: a signal that such a thread takes is sent on to main.
#pragma once

#include <chrono>
#include <csignal>
#include <ctime>
#include <pthread.h>

namespace lcdm {

// Made before any thread is: threads inherit that the signals are blocked.
class StopSignals {
 public:
  StopSignals() {
    sigemptyset(&set_);
    main_thread() = pthread_self();
    struct sigaction action {};
    action.sa_handler = [](int signal) { pthread_kill(main_thread(), signal); };
    action.sa_flags = SA_RESTART;
    for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
      struct sigaction before {};
      sigaction(signal, nullptr, &before);
      if (before.sa_handler == SIG_IGN) continue;
      sigaddset(&set_, signal);
      sigaction(signal, &action, nullptr);
    }
    pthread_sigmask(SIG_BLOCK, &set_, nullptr);
  }

  // True when one of them came within `time`.
  bool wait_for(std::chrono::milliseconds time) const {
    const timespec timeout{time.count() / 1000, time.count() % 1000 * 1'000'000};
    return sigtimedwait(&set_, nullptr, &timeout) > 0;
  }

 private:
  static pthread_t& main_thread() {
    static pthread_t thread;
    return thread;
  }

  sigset_t set_{};
};

}  // namespace lcdm
