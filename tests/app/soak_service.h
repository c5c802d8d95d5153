// `lcdm run` on the soak's camera, seen from outside: what it serves, what it holds, and what can
// be done to its disk and its clients.
#pragma once

#include <chrono>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <sys/ptrace.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <thread>
#include <vector>

#include "tests/app/program.h"
#include "tests/app/raw_client.h"
#include "tests/support/fake_v4l2.h"
#include "tests/support/random_model.h"
#include "tests/support/temporary_folder.h"

namespace lcdm::test {

class SoakService {
 public:
  SoakService() {
    std::signal(SIGXFSZ, SIG_IGN);  // inherited; see fill_disk
    program_.emplace(LCDM_PROGRAM, arguments());
  }

  // False when it does not come up.
  bool streams() {
    const std::string mark = "http://127.0.0.1:";
    if (!program_->wait_for("\nstreaming\n")) return false;
    port_ = std::stoi(program_->text().substr(program_->text().find(mark) + mark.size()));
    return true;
  }
  int port() const { return port_; }

  // What it says on its page; an empty object when it does not answer.
  nlohmann::json status() {
    program_->listen();
    const std::string answer = get(port_, "/status.json");
    const std::size_t body = answer.find("\r\n\r\n");
    if (body == std::string::npos) return nlohmann::json::object();
    return nlohmann::json::parse(answer.substr(body));
  }
  // One figure of it.
  std::int64_t figure(const char* pointer) {
    return status().value(nlohmann::json::json_pointer(pointer), std::int64_t{-1});
  }

  const std::string& text() const { return program_->text(); }

  // Ends it as systemd does, and gives its exit status.
  int stop() {
    kill(program_->pid(), SIGTERM);
    return program_->wait();
  }

  std::int64_t resident_kilobytes() const {
    std::ifstream file("/proc/" + std::to_string(program_->pid()) + "/status");
    for (std::string line; std::getline(file, line);) {
      if (line.rfind("VmRSS:", 0) == 0) return std::stoll(line.substr(6));
    }
    return -1;
  }
  int descriptors() const {
    namespace fs = std::filesystem;
    const fs::directory_iterator folder("/proc/" + std::to_string(program_->pid()) + "/fd");
    return static_cast<int>(std::distance(begin(folder), end(folder)));
  }

  void start_recording() { request(port_, "POST", "/record/start"); }
  void stop_recording() { request(port_, "POST", "/record/stop"); }

  // From now on no file of the process gets longer, as on a full disk: writing is an error (which
  // comes as a signal, too, that is ignored).
  void fill_disk(bool full) {
    const rlimit most{full ? 0 : RLIM_INFINITY, RLIM_INFINITY};
    prlimit(program_->pid(), RLIMIT_FSIZE, &most, nullptr);
  }

  // The disk takes nothing: the thread that writes to it stands still, as in a write() that does
  // not return. False: this machine does not let us hold it.
  bool halt_disk() {
    // It has its name a moment after it was started.
    for (int i = 0; i < 50 && (writer_ = program_->thread_of("record")) == 0; ++i) {
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    if (writer_ == 0 || ptrace(PTRACE_SEIZE, writer_, nullptr, nullptr) != 0) return false;
    ptrace(PTRACE_INTERRUPT, writer_, nullptr, nullptr);
    return waitpid(writer_, nullptr, __WALL) == writer_;
  }
  void release_disk() { ptrace(PTRACE_DETACH, writer_, nullptr, nullptr); }

  // Clients of every kind that ask and then do not read, or do not even end their question.
  void attach_stalled_clients() {
    for (const char* asked : {"/live", "/stream.mjpg", "/stream.mjpg?view=colour", "/depth.png"}) {
      attach("GET " + std::string(asked) + " HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n");
    }
    attach("GET /status.json HTT");
    attach("");
  }
  void detach_clients() { stalled_.clear(); }

 private:
  std::vector<std::string> arguments() const {
    const auto image = make_random_model(make_config(EncoderKind::kXxs, PresetKind::kLcdm), 1);
    std::vector<std::string> all = {
        "run", "--source", std::string("v4l2:") + FakeV4l2::kPath,   "--port",
        "0",   "--model",  folder_.write("model.safetensors", image)};
    for (const std::string& setting :
         {std::string("model.width=64"), std::string("model.height=64"),
          std::string("model.threads=1"), std::string("record.keep_free_megabytes=0"),
          "record.directory=" + folder_.file("recordings")}) {
      all.insert(all.end(), {"--set", setting});
    }
    return all;
  }

  void attach(const std::string& question) {
    stalled_.push_back(std::make_unique<RawClient>(port_));
    stalled_.back()->send(question);
  }

  TemporaryFolder folder_;
  std::optional<Program> program_;
  int port_ = 0;
  pid_t writer_ = 0;
  std::vector<std::unique_ptr<RawClient>> stalled_;
};

}  // namespace lcdm::test
