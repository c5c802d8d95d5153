#include "drivers/thermal.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <optional>
#include <system_error>

#include "firmware/base/folder.h"

namespace lcdm {
namespace {

namespace fs = std::filesystem;

// Sensors that are not there, and trip points nobody filled in, give values outside of these.
constexpr double kLeastCelsius = -40;
constexpr double kMostCelsius = 150;
constexpr double kLeastLimit = 40;

std::optional<double> read_number(const fs::path& file) {
  std::ifstream stream(file);
  double number = 0;
  if (!(stream >> number)) return std::nullopt;
  return number;
}

std::string read_word(const fs::path& file) {
  std::ifstream stream(file);
  std::string word;
  std::getline(stream, word);
  return word;
}

// The entries of `folder` whose names begin with `prefix`, sorted.
std::vector<fs::path> entries(const fs::path& folder, const std::string& prefix) {
  const auto all = list_folder(folder);
  if (!all) return {};
  std::vector<fs::path> found;
  std::copy_if(all->begin(), all->end(), std::back_inserter(found), [&](const fs::path& path) {
    return path.filename().string().rfind(prefix, 0) == 0;
  });
  return found;
}

// Where the system begins to hold back: the lowest passive or hot trip point, else the critical
// one. Infinity where there is none.
double limit_of(const fs::path& zone) {
  double hold_back = std::numeric_limits<double>::infinity();
  double critical = hold_back;
  for (int i = 0;; ++i) {
    const std::string trip = "trip_point_" + std::to_string(i);
    const std::string type = read_word(zone / (trip + "_type"));
    if (type.empty()) break;
    const double celsius = read_number(zone / (trip + "_temp")).value_or(0) / 1000;
    if (celsius < kLeastLimit || celsius > kMostCelsius) continue;
    if (type == "passive" || type == "hot") hold_back = std::min(hold_back, celsius);
    if (type == "critical") critical = std::min(critical, celsius);
  }
  return std::isinf(hold_back) ? critical : hold_back;
}

// Fans cool too, but cost no speed.
bool holds_back(const std::string& cooling_type) {
  for (const char* each : {"cpufreq", "devfreq", "Processor"}) {
    if (cooling_type.find(each) != std::string::npos) return true;
  }
  return false;
}

}  // namespace

Thermal::Thermal(const std::string& sysfs) {
  const fs::path root(sysfs);
  for (const fs::path& zone : entries(root / "class/thermal", "thermal_zone")) {
    zones_.push_back({read_word(zone / "type"), (zone / "temp").string(), limit_of(zone)});
  }
  for (const fs::path& device : entries(root / "class/thermal", "cooling_device")) {
    if (!holds_back(read_word(device / "type"))) continue;
    cooling_state_files_.push_back((device / "cur_state").string());
  }
  for (const fs::path& policy : entries(root / "devices/system/cpu/cpufreq", "policy")) {
    const double possible = read_number(policy / "cpuinfo_max_freq").value_or(0);
    if (possible > 0) policies_.push_back({(policy / "scaling_max_freq").string(), possible});
  }
}

ThermalReading Thermal::read() const {
  ThermalReading reading;
  for (const Zone& zone : zones_) {
    const std::optional<double> raw = read_number(zone.temperature_file);
    if (!raw || *raw / 1000 < kLeastCelsius || *raw / 1000 > kMostCelsius) continue;
    const double celsius = *raw / 1000;
    const double headroom = zone.limit_celsius - celsius;
    const bool nearer = headroom < reading.headroom_celsius;
    const bool hotter = headroom == reading.headroom_celsius && celsius > reading.celsius;
    if (!reading.zone.empty() && !nearer && !hotter) continue;
    reading.zone = zone.name;
    reading.celsius = celsius;
    reading.headroom_celsius = headroom;
  }
  for (const std::string& file : cooling_state_files_) {
    if (read_number(file).value_or(0) > 0) reading.throttled = true;
  }
  for (const Policy& policy : policies_) {
    const double allowed = read_number(policy.allowed_file).value_or(policy.possible_khz);
    reading.cpu_limit = std::min(reading.cpu_limit, allowed / policy.possible_khz);
  }
  return reading;
}

}  // namespace lcdm
