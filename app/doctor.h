// What could keep this machine from being a camera: each finding one line with its cure.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "app/config.h"
#include "app/doctor_account.h"
#include "app/finding.h"

namespace lcdm {

// The whole examination, for the service's account where it is installed. `root` stands before
// every path of the system's own (/sys, /proc, /etc, /dev/gpiochip*), so that tests can bring
// another; empty: this machine. Takes the time of preparing an engine, and of a trial of the
// camera.
std::vector<Finding> examine(const Config& config, const std::string& root);

// Two looks of it; the others are in doctor_camera.h and doctor_machine.h.
Finding check_service(const ServiceUnit& unit);
Finding check_model(const Config& config, std::uint64_t& engine_bytes);

}  // namespace lcdm
