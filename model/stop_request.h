// How a person or the system asks a training to stop: it ends its step, saves and goes.
#pragma once

#include <csignal>

namespace lcdm::model {

inline volatile std::sig_atomic_t stop_asked = 0;

// From here on Ctrl-C, SIGTERM and a closed terminal only ask. One that is ignored at the start, as
// SIGHUP under nohup, stays so.
inline void stop_on_signals() {
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
    const auto before = std::signal(signal, [](int) { stop_asked = 1; });
    if (before == SIG_IGN) std::signal(signal, SIG_IGN);
  }
  std::signal(SIGPIPE, SIG_IGN);  // who reads what it prints may go: it trains on
}

inline bool must_stop() { return stop_asked != 0; }

}  // namespace lcdm::model
