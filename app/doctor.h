// What could keep this machine from being a camera: each finding one line with its cure.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "app/config.h"
#include "app/doctor_account.h"
#include "drivers/v4l2_formats.h"
#include "drivers/v4l2_nodes.h"

namespace lcdm {

enum class Severity {
  kOk,
  kWarning,  // depth comes, but less, or less safely
  kFault,    // no depth until it is mended
};

const char* to_string(Severity severity);

struct Finding {
  Severity severity = Severity::kOk;
  std::string subject;  // what was looked at, one word
  std::string text;     // what was found; where it is not well, with its cure
};

// The whole examination. `root` stands before every path of the system's own (/sys, /proc, /etc,
// /dev/gpiochip*), so that tests can bring another; empty: this machine. Takes the time of
// preparing an engine.
std::vector<Finding> examine(const Config& config, const std::string& root);

// The single looks, in the order in which `examine` takes them. What may be opened is judged for
// `account`, whom those texts name.
Finding check_service(const ServiceUnit& unit);
std::vector<Finding> check_cameras(const std::vector<V4l2Node>& nodes, const std::string& source,
                                   const Account& account);
// `ids`: the cameras that libcamera knows.
Finding check_libcamera(const std::string& source, const std::vector<std::string>& ids);
// What the driver lists.
Finding check_rate(const std::vector<V4l2Mode>& modes, const CaptureRequest& request);
// What really came, in frames/s; kUnavailable: it could not be measured.
Finding check_arrivals(const Result<float>& measured, float wanted);
Finding check_model(const Config& config, std::uint64_t& engine_bytes);
Finding check_memory_lock(const std::string& root, const Account& account,
                          std::uint64_t engine_bytes);
Finding check_disk(const std::string& directory, int keep_free_megabytes, const Account& account);
// The configured files that cannot be used.
std::vector<Finding> check_files(const Config& config, const Account& account);
// `is_only`: lcdm listens nowhere else.
Finding check_port(const std::string& listen, int port, bool is_only);
Finding check_clock(bool synchronised);
Finding check_hardware_watchdog(const std::string& root);
// One for each configured line; none where none is configured.
std::vector<Finding> check_gpio(const Config::Gpio& lines, const std::string& root,
                                const Account& account);

}  // namespace lcdm
