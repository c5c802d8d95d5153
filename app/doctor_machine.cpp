#include "app/doctor_machine.h"

#include <cerrno>
#include <filesystem>
#include <fstream>
#include <optional>
#include <sys/statvfs.h>
#include <system_error>
#include <unistd.h>
#include <utility>

#include "app/address.h"
#include "app/calibration_file.h"
#include "app/http_token.h"
#include "drivers/gpio/gpio.h"
#include "firmware/base/folder.h"

namespace lcdm {
namespace {

namespace fs = std::filesystem;

constexpr std::uint64_t kMiB = 1U << 20;

std::string first_line(const fs::path& file) {
  std::ifstream stream(file);
  std::string line;
  std::getline(stream, line);
  return line;
}

// The first GPIO chip that the account may not open; empty: there is none such.
std::string closed_gpio_chip(const std::string& root, const Account& account) {
  const auto devices = list_folder(root + "/dev");
  for (const fs::path& device : devices ? *devices : std::vector<fs::path>{}) {
    const std::string name = device.filename().string();
    if (name.rfind("gpiochip", 0) != 0) continue;
    if (!account.may(device, R_OK | W_OK)) return "/dev/" + name;
  }
  return "";
}

// Asks for a line as an input, whatever it is for: that drives nothing.
Finding check_line(const std::string& key, const std::string& name) {
  const auto line = request_gpio_line(name, GpioUse::kInput);
  if (line) return well("gpio", key + ": " + name + " is there");
  const std::string text = key + ": " + line.status().text();
  if (line.code() == StatusCode::kUnavailable) {
    return warning("gpio", text + ": it may be lcdm itself, if it runs");
  }
  return warning("gpio", text + ": lcdm goes on without: set a name that gpioinfo lists, or none");
}

// Empty: `path` is fine, or not configured. `read`: what reading it ourselves gave.
std::optional<Finding> check_file(const char* key, const std::string& path, const Account& account,
                                  const Status& read) {
  if (path.empty() || (read && account.may(path, R_OK))) return std::nullopt;
  if (!account.may(path, R_OK)) {
    return fault("files", std::string(key) + ": " + account.name + " may not read " + path +
                              ": give it to that account's group and chmod 640 it");
  }
  if (!account.is_caller && read.sys_errno() == EACCES) {
    return well("files", path + ": " + account.name +
                             " may read it, this user not: `sudo lcdm doctor` says more");
  }
  return fault("files", read.text());
}

}  // namespace

// Memory that was swapped out comes back too late for a frame.
Finding check_memory_lock(const std::string& root, const Account& account,
                          std::uint64_t engine_bytes) {
  if (account.memory_lock_bytes >= engine_bytes) {
    return well("memory", account.name + " may lock the engine's arena and weights");
  }
  std::ifstream swaps(root + "/proc/swaps");
  std::string header;
  std::string first;
  std::getline(swaps, header);
  std::getline(swaps, first);
  if (first.empty()) return well("memory", "there is no swap that could slow the engine");
  return warning("memory", account.name + " may lock only " +
                               std::to_string(account.memory_lock_bytes / kMiB) + " MiB of " +
                               std::to_string(engine_bytes / kMiB) +
                               " MiB, and there is swap: LimitMEMLOCK=infinity in the unit, or "
                               "`swapoff -a`");
}

Finding check_disk(const std::string& directory, int keep_free_megabytes, const Account& account) {
  std::error_code error;
  fs::path existing = fs::absolute(directory, error);
  const bool comes = account.makes_at_start(existing);
  while (!fs::exists(existing, error) && existing.has_relative_path()) {
    existing = existing.parent_path();
  }
  struct statvfs disk {};
  const bool there = statvfs(existing.c_str(), &disk) == 0;
  if (!there || (!comes && !account.may(existing, W_OK))) {
    return warning("disk", existing.string() + ": no recording possible (" +
                               std::generic_category().message(there ? EACCES : errno) +
                               "): set record.directory to a folder that " + account.name +
                               " may write");
  }
  const std::uint64_t free_mb = std::uint64_t{disk.f_bavail} * disk.f_frsize >> 20;
  const std::string text =
      existing.string() + ": " + std::to_string(free_mb) + " MiB free for " + account.name;
  if (free_mb <= static_cast<std::uint64_t>(keep_free_megabytes)) {
    return warning("disk", text + ", recording keeps " + std::to_string(keep_free_megabytes) +
                               " MiB free: delete old recordings or set record.directory");
  }
  return well("disk", text);
}

std::vector<Finding> check_files(const Config& config, const Account& account) {
  std::vector<Finding> unusable;
  const auto add = [&](const char* key, const std::string& path, const Status& read) {
    if (const auto finding = check_file(key, path, account, read)) unusable.push_back(*finding);
  };
  add("model.file", config.model.file, Status::ok());  // what is in it check_model says
  const std::string& token = config.http.token_file;
  add("http.token_file", token, token.empty() ? Status::ok() : read_token(token).status());
  const std::string& calibration = config.camera.calibration;
  add("camera.calibration", calibration,
      calibration.empty() ? Status::ok() : read_calibration(calibration).status());
  return unusable;
}

Finding check_port(const std::string& listen, int port, const Account& account) {
  constexpr int kFirstForAll = 1024;  // the kernel's default, ip_unprivileged_port_start
  const std::string place = listen + ":" + std::to_string(port);
  if (!account.is_caller && account.user != 0 && port > 0 && port < kFirstForAll) {
    return fault("port", place + ": " + account.name + " may not listen below " +
                             std::to_string(kFirstForAll) + ": choose another http.port");
  }
  const int error = bind_error(listen, port);
  if (error == EADDRINUSE) {
    return warning("port", place +
                               " is in use: by lcdm itself if it runs, else choose another "
                               "http.port");
  }
  if (error == EADDRNOTAVAIL) {
    return warning("port", place + ": this machine lacks that address now: lcdm waits for it");
  }
  if (error != 0) {
    return fault("port", place + ": " + std::generic_category().message(error) +
                             ": choose another http.listen or http.port");
  }
  return well("port", place + " is free");
}

Finding check_clock(bool synchronised) {
  if (synchronised) return well("clock", "synchronised");
  return warning(
      "clock",
      "not synchronised: recordings carry a wrong time of day: `timedatectl set-ntp true`");
}

Finding check_hardware_watchdog(const std::string& root) {
  const fs::path folder = root + "/sys/class/watchdog/watchdog0";
  std::error_code error;
  if (!fs::exists(folder, error)) {
    return warning("watchdog",
                   "this machine has none: a kernel that crashes stays down; load the "
                   "board's watchdog module");
  }
  const std::string identity = first_line(folder / "identity");
  if (first_line(folder / "state") != "active") {
    return warning("watchdog",
                   identity +
                       " is idle: reboot once after the package was installed; without it, "
                       "RuntimeWatchdogSec=15 in /etc/systemd/system.conf.d/lcdm.conf and "
                       "`systemctl daemon-reexec`");
  }
  return well("watchdog", identity + " is active");
}

std::vector<Finding> check_gpio(const Config::Gpio& lines, const std::string& root,
                                const Account& account) {
  const std::pair<const char*, std::string> configured[] = {{"gpio.light", lines.light},
                                                            {"gpio.button", lines.button},
                                                            {"gpio.heartbeat", lines.heartbeat}};
  const std::string closed = closed_gpio_chip(root, account);
  std::vector<Finding> findings;
  for (const auto& [key, name] : configured) {
    if (name.empty()) continue;
    findings.push_back(closed.empty() ? check_line(key, name)
                                      : warning("gpio", closed + ": " + account.name +
                                                            " may not open it for " + key +
                                                            ": add it to the group gpio"));
  }
  return findings;
}

}  // namespace lcdm
