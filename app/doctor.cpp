#include "app/doctor.h"

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <optional>
#include <sys/statvfs.h>
#include <sys/timex.h>
#include <system_error>
#include <unistd.h>
#include <utility>

#include "app/address.h"
#include "app/calibration_file.h"
#include "app/common_options.h"
#include "app/doctor_rate.h"
#include "app/http_token.h"
#include "app/source.h"
#include "drivers/gpio.h"
#ifdef LCDM_LIBCAMERA
#include "drivers/libcamera_camera.h"
#endif
#include "drivers/v4l2_device.h"
#include "firmware/base/folder.h"

namespace lcdm {
namespace {

namespace fs = std::filesystem;

constexpr std::uint64_t kMiB = 1U << 20;

Finding well(const char* subject, std::string text) {
  return {Severity::kOk, subject, std::move(text)};
}
Finding warning(const char* subject, std::string text) {
  return {Severity::kWarning, subject, std::move(text)};
}
Finding fault(const char* subject, std::string text) {
  return {Severity::kFault, subject, std::move(text)};
}

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof(text), "%g", value);
  return text;
}

std::string first_line(const fs::path& file) {
  std::ifstream stream(file);
  std::string line;
  std::getline(stream, line);
  return line;
}

bool is_camera_source(const std::string& source) {
  return source == "auto" || source.rfind("v4l2:", 0) == 0 || source.rfind("libcamera:", 0) == 0;
}

// A camera on a slower bus than it could use: no rate, or only compressed frames.
Finding check_bus(const V4l2Node& node) {
  const std::string name = node.path + " (" + node.card + ")";
  if (node.usb_mbps == 0) return well("camera", name + ": not on USB, driver " + node.driver);
  const std::string speed =
      name + ": USB at " + number(static_cast<double>(node.usb_mbps)) + " Mb/s";
  if (node.usb_mbps < 480) {
    return warning("camera", speed + ", too slow for video: use a USB 2 or 3 port and cable");
  }
  if (node.usb_version >= 3 && node.usb_mbps < 5000) {
    return warning("camera", speed + ", though it is made for USB " +
                                 number(static_cast<double>(node.usb_version)) +
                                 ": use a blue port and a USB 3 cable");
  }
  return well("camera", speed);
}

// The service may have fewer rights than who calls, root above all, and it may have more.
Finding check_node(const V4l2Node& node, const Account& account) {
  if (!account.is_caller && !account.may(node.path, R_OK | W_OK)) {
    return fault("camera", node.path + ": " + account.name +
                               " may not open it: SupplementaryGroups=video in the unit");
  }
  if (!account.is_caller && access(node.path.c_str(), R_OK | W_OK) != 0 && errno == EACCES) {
    return well("camera", node.path + ": " + account.name +
                              " may open it, this user not: `sudo lcdm doctor` says more");
  }
  return node.usable ? check_bus(node) : warning("camera", node.reason);
}

// Without this the recovery ladder lacks a rung.
Finding check_port_reset(const V4l2Node& node, const Account& account) {
  if (account.may(node.usb, W_OK)) {
    return well("reset", node.usb + " may be reset by " + account.name);
  }
  return warning("reset", node.usb + ": " + account.name +
                              " may not reset it when the camera hangs: give the group video "
                              "write permission (a udev rule)");
}

// The node that the configuration's source means now; empty: none.
std::string configured_node(const std::string& source, const std::vector<V4l2Node>& nodes) {
  if (source.rfind("v4l2:", 0) == 0) {
    const Result<std::string> found = find_v4l2_node(source.substr(5));
    return found ? *found : "";
  }
  if (source != "auto") return "";
  const auto first =
      std::find_if(nodes.begin(), nodes.end(), [](const V4l2Node& node) { return node.usable; });
  return first == nodes.end() ? "" : first->path;
}

bool clock_is_synchronised() {
  timex state{};
  return adjtimex(&state) != TIME_ERROR && (state.status & STA_UNSYNC) == 0;
}

std::vector<std::string> libcamera_cameras() {
#ifdef LCDM_LIBCAMERA
  return list_libcamera_cameras();
#else
  return {};
#endif
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

// A source that is no camera: its files must be there.
Finding check_replayed(const std::string& source) {
  const std::size_t colon = source.find(':');
  std::error_code error;
  const bool is_files = source.rfind("file:", 0) == 0 || source.rfind("mcap:", 0) == 0;
  if (is_files && !fs::exists(source.substr(colon + 1), error)) {
    return fault("camera", source + ": there is no such file or folder: set camera.source");
  }
  return well("camera", source + ": needs none");
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

// What really comes from the camera: by a trial, or by the counters of the lcdm that holds it.
Finding try_camera(const std::string& uri, const Config& config) {
  const CaptureRequest request = capture_request(config);
  const Result<OpenedSource> source = open_source(uri, Playback::kLive);
  if (!source) return fault("rate", source.status().text());
  Camera& camera = *source->camera;
  const Result<float> measured = measure_rate(camera, request);
  const bool held = measured.status().sys_errno() == EBUSY;
  const float promised = camera.info().frames_per_second;
  return check_arrivals(
      held ? served_rate(config, uri) : measured,
      promised > 0 ? std::min(promised, request.frames_per_second) : request.frames_per_second);
}

// Of the configured camera, where it is there: what its driver lists, and what comes.
std::vector<Finding> check_rates(const Config& config, const std::vector<V4l2Node>& nodes) {
  const std::string& source = config.camera.source;
  if (source.rfind("libcamera:", 0) == 0) {
    const bool known = check_libcamera(source, libcamera_cameras()).severity == Severity::kOk;
    return known ? std::vector{try_camera(source, config)} : std::vector<Finding>{};
  }
  const std::string node = configured_node(source, nodes);
  std::vector<Finding> findings;
  {
    V4l2Device device;
    if (node.empty() || !device.open(node)) return {};
    const CaptureRequest request = capture_request(config);
    findings.push_back(check_rate(list_modes(device, request), request));
  }
  findings.push_back(try_camera(source == "auto" ? "v4l2:" + node : source, config));
  return findings;
}

// Who is judged; where the service is installed but its account is not, the caller.
Account account_of(const ServiceUnit& unit, std::vector<Finding>& findings) {
  if (unit.file.empty()) return calling_account();
  const Result<Account> account = service_account(unit);
  if (account) return *account;
  findings.push_back(fault("service", account.status().text()));
  return calling_account();
}

}  // namespace

const char* to_string(Severity severity) {
  switch (severity) {
    case Severity::kOk:
      return "ok";
    case Severity::kWarning:
      return "warning";
    case Severity::kFault:
      return "fault";
  }
  return "unknown";
}

std::vector<Finding> examine(const Config& configured, const std::string& root) {
  const ServiceUnit unit = read_service_unit(root);
  std::vector<Finding> findings = {check_service(unit)};
  const Account account = account_of(unit, findings);
  const Config config = as_seen_by(account, configured);
  const auto add = [&findings](std::vector<Finding> more) {
    std::move(more.begin(), more.end(), std::back_inserter(findings));
  };
  const std::vector<V4l2Node> nodes = list_v4l2_nodes();
  add(check_cameras(nodes, config.camera.source, account));
  add(check_rates(config, nodes));
  std::uint64_t engine_bytes = 0;
  findings.push_back(check_model(config, engine_bytes));
  findings.push_back(check_memory_lock(root, account, engine_bytes));
  findings.push_back(
      check_disk(config.record.directory, config.record.keep_free_megabytes, account));
  add(check_files(config, account));
  const std::vector<std::string> addresses = listen_addresses(config.http.listen);
  for (const std::string& address : addresses) {
    findings.push_back(check_port(address, config.http.port, addresses.size() == 1));
  }
  findings.push_back(check_clock(clock_is_synchronised()));
  findings.push_back(check_hardware_watchdog(root));
  add(check_gpio(config.gpio, root, account));
  return findings;
}

Finding check_service(const ServiceUnit& unit) {
  if (unit.file.empty()) {
    return warning("service", "not installed: nothing starts lcdm at boot: install the package");
  }
  const std::string watchdog = unit.setting("WatchdogSec");
  if (watchdog.empty()) {
    return warning("service", unit.file +
                                  ": WatchdogSec= is missing: a program that hangs is "
                                  "not restarted; install the package's unit");
  }
  return well("service", unit.file + ", WatchdogSec=" + watchdog);
}

std::vector<Finding> check_cameras(const std::vector<V4l2Node>& nodes, const std::string& source,
                                   const Account& account) {
  std::vector<Finding> findings;
  const bool usable =
      std::any_of(nodes.begin(), nodes.end(), [](const V4l2Node& node) { return node.usable; });
  for (const V4l2Node& node : nodes) {
    if (usable && !node.usable) continue;  // beside a camera that works its metadata is no news
    findings.push_back(check_node(node, account));
    if (node.usable && !node.usb.empty()) findings.push_back(check_port_reset(node, account));
  }
  if (source.rfind("v4l2:", 0) == 0) {
    const Result<std::string> node = find_v4l2_node(source.substr(5));
    V4l2Device device;
    const Status opened = node ? device.open(*node) : node.status();
    const bool closed_to_us_alone = !account.is_caller && opened.sys_errno() == EACCES;
    if (!opened && !closed_to_us_alone) findings.push_back(fault("camera", opened.text()));
  } else if (source == "auto" && !usable) {
    findings.push_back(
        warning("camera", "auto finds none and shows the rendered scene: plug one in"));
  } else if (!is_camera_source(source)) {
    findings.push_back(check_replayed(source));
  } else if (source.rfind("libcamera:", 0) == 0) {
    findings.push_back(check_libcamera(source, libcamera_cameras()));
  }
  return findings;
}

Finding check_libcamera(const std::string& source, const std::vector<std::string>& ids) {
  std::string known;
  for (const std::string& id : ids) {
    if (source == "libcamera:" + id) return well("camera", source + ": libcamera knows it");
    known += (known.empty() ? "" : ", ") + id;
  }
  return fault("camera", source + ": libcamera knows " +
                             (ids.empty() ? "no camera (if this lcdm was built with it)" : known) +
                             ": set camera.source to one that `lcdm probe` lists");
}

Finding check_rate(const std::vector<V4l2Mode>& modes, const CaptureRequest& request) {
  const auto choice = choose_mode(modes, request);
  if (!choice) return fault("rate", "the camera offers no format that lcdm reads");
  float best = 0;
  for (const V4l2Mode& mode : modes) {
    const bool chosen = mode.fourcc == choice->fourcc && mode.width <= choice->width &&
                        choice->width <= mode.max_width && mode.height <= choice->height &&
                        choice->height <= mode.max_height;
    if (chosen)
      for (const float rate : mode.rates) best = std::max(best, rate);
  }
  const std::string mode = std::string(to_string(choice->pixel)) + " " +
                           std::to_string(choice->width) + "x" + std::to_string(choice->height);
  if (best == 0) return well("rate", mode + ": the driver lists no rates");
  const std::string rate = mode + " at " + number(static_cast<double>(best)) + " frames/s";
  if (best < 0.95F * request.frames_per_second) {
    return warning("rate", rate + ", " + number(static_cast<double>(request.frames_per_second)) +
                               " are wanted: set a smaller camera.width and height (`lcdm probe`), "
                               "or a lower camera.frames_per_second");
  }
  return well("rate", rate);
}

Finding check_arrivals(const Result<float>& measured, float wanted) {
  if (!measured && measured.code() == StatusCode::kUnavailable) {
    return well("rate", std::string("not measured: ") + measured.status().text());
  }
  if (!measured) return fault("rate", measured.status().text());
  char text[64];
  std::snprintf(text, sizeof(text), "%.1f frames/s come of %g", static_cast<double>(*measured),
                static_cast<double>(wanted));
  if (*measured >= 0.8F * wanted) return well("rate", text);
  return warning("rate", std::string(text) +
                             ": give it more light or a shorter camera.exposure_ms, a USB bus of "
                             "its own, or a smaller camera.width and height");
}

Finding check_model(const Config& config, std::uint64_t& engine_bytes) {
  const Result<ModelFile> file = load_model(config);
  if (!file) return fault("model", file.status().text());
  const CaptureRequest request = capture_request(config);
  const FrameFormat format{PixelFormat::kRgb24, request.width, request.height, request.width * 3};
  const auto engine = Engine::prepare(
      *file, engine_options(config), format,
      CameraModel::from_field_of_view(format.width, format.height, request.assumed_field_of_view));
  if (!engine) return fault("model", engine.status().text());
  const EngineStats stats = (*engine)->stats();
  engine_bytes = stats.arena_bytes + stats.weight_bytes;
  return well("model", stats.model_name + " at " + std::to_string(stats.width) + "x" +
                           std::to_string(stats.height) + ", " +
                           std::to_string(engine_bytes / kMiB) + " MiB");
}

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

Finding check_port(const std::string& listen, int port, bool is_only) {
  const int error = bind_error(listen, port);
  const std::string place = listen + ":" + std::to_string(port);
  if (error == EADDRINUSE) {
    return warning("port", place +
                               " is in use: by lcdm itself if it runs, else choose another "
                               "http.port");
  }
  const bool lacking = error == EADDRNOTAVAIL || error == EAFNOSUPPORT;
  if (lacking && !is_only) {
    return warning("port", place +
                               ": this machine lacks that address now, or its HTTP library IPv6: "
                               "lcdm leaves it out until it is started again");
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
    return warning("watchdog", identity +
                                   " is idle: RuntimeWatchdogSec=10 in /etc/systemd/"
                                   "system.conf.d/lcdm.conf, then `systemctl daemon-reexec`");
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
