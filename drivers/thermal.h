// How hot the board is and whether the system holds its processor back, as sysfs tells.
#pragma once

#include <limits>
#include <string>
#include <vector>

namespace lcdm {

struct ThermalReading {
  std::string zone;    // the one nearest to its limit; else the hottest; empty: none can be read
  double celsius = 0;  // of that zone
  double headroom_celsius = std::numeric_limits<double>::infinity();  // from there to its limit
  bool throttled = false;  // a cooling device holds back the processor or the graphics unit
  double cpu_limit = 1;    // highest frequency allowed now by the highest possible, of the worst
                           // processor; a power mode lowers it too
};

// Zones, cooling devices and frequency policies are looked up once; read() opens a few small files.
// What a board lacks, or what cannot be read, is left out. Belongs to one thread.
class Thermal {
 public:
  // `sysfs`: where it is mounted.
  explicit Thermal(const std::string& sysfs = "/sys");

  ThermalReading read() const;

 private:
  struct Zone {
    std::string name;
    std::string temperature_file;  // millidegrees
    double limit_celsius;          // where the system begins to hold back; infinity: none
  };
  struct Policy {
    std::string allowed_file;  // kHz
    double possible_khz;
  };

  std::vector<Zone> zones_;
  std::vector<std::string> cooling_state_files_;
  std::vector<Policy> policies_;
};

}  // namespace lcdm
