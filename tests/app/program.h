// Runs programs as a person or a script would: arguments in, exit status and text out.
#pragma once

#include <fcntl.h>
#include <filesystem>
#include <fstream>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <string>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>
#include <vector>

#include "firmware/base/check.h"
#include "firmware/base/os.h"

namespace lcdm::test {

// A running child; standard output and error come back as one text. Killed when dropped.
class Program {
 public:
  Program(const std::string& path, const std::vector<std::string>& arguments,
          const std::vector<std::string>& more_environment = {}) {
    int ends[2];
    LCDM_CHECK(pipe2(ends, O_CLOEXEC) == 0);
    std::vector<char*> argv{const_cast<char*>(path.c_str())};
    for (const std::string& each : arguments) argv.push_back(const_cast<char*>(each.c_str()));
    argv.push_back(nullptr);
    std::vector<char*> environment;
    for (const std::string& each : more_environment) {
      environment.push_back(const_cast<char*>(each.c_str()));
    }
    for (char** each = environ; *each != nullptr; ++each) environment.push_back(*each);
    environment.push_back(nullptr);
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, ends[1], STDOUT_FILENO);
    posix_spawn_file_actions_adddup2(&actions, ends[1], STDERR_FILENO);
    LCDM_CHECK(
        posix_spawn(&pid_, path.c_str(), &actions, nullptr, argv.data(), environment.data()) == 0);
    posix_spawn_file_actions_destroy(&actions);
    close(ends[1]);
    output_ = ends[0];
  }
  ~Program() {
    if (pid_ > 0) {
      kill(pid_, SIGKILL);
      waitpid(pid_, nullptr, 0);
    }
    close(output_);
  }
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;

  pid_t pid() const { return pid_; }
  const std::string& text() const { return text_; }
  // Its thread of this name; 0: it has none.
  pid_t thread_of(const std::string& name) const {
    const std::string tasks = "/proc/" + std::to_string(pid_) + "/task";
    for (const auto& task : std::filesystem::directory_iterator(tasks)) {
      std::ifstream file(task.path() / "comm");
      std::string comm;
      std::getline(file, comm);
      if (comm == name) return std::stoi(task.path().filename().string());
    }
    return 0;
  }

  // Reads until the text holds `wanted`. False when the program ended or the time is over.
  bool wait_for(const std::string& wanted, int seconds = 20) {
    const std::int64_t end = os::monotonic_ns() + seconds * 1'000'000'000LL;
    while (text_.find(wanted) == std::string::npos) {
      if (!read_more(end)) return false;
    }
    return true;
  }

  // Takes what it has said by now: one that nobody listens to stops when the pipe is full.
  void listen() {
    while (read_more(os::monotonic_ns() + 2'000'000)) continue;
  }

  // Reads until the program has ended and gives its exit status; -1 when the time is over or a
  // signal ended it. A child of the program that lives on and holds the pipe is not waited for.
  int wait(int seconds = 60) {
    const std::int64_t end = os::monotonic_ns() + seconds * 1'000'000'000LL;
    while (os::monotonic_ns() < end) {
      int status = 0;
      const bool ended = waitpid(pid_, &status, WNOHANG) == pid_;
      while (read_more(os::monotonic_ns() + 5'000'000)) {
      }
      if (ended) {
        pid_ = 0;
        return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
    return -1;
  }

 private:
  bool read_more(std::int64_t end_ns) {
    pollfd waiting{output_, POLLIN, 0};
    const auto left = static_cast<int>((end_ns - os::monotonic_ns()) / 1'000'000);
    if (left <= 0 || poll(&waiting, 1, left) <= 0) return false;
    char buffer[4096];
    const auto got = read(output_, buffer, sizeof(buffer));
    if (got <= 0) return false;
    text_.append(buffer, static_cast<std::size_t>(got));
    return true;
  }

  pid_t pid_ = 0;
  int output_ = -1;
  std::string text_;
};

}  // namespace lcdm::test
