// sysfs as boards have it, written by the test.
#include "drivers/thermal.h"

#include <cmath>
#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>

#include "tests/support/temporary_folder.h"

namespace lcdm {
namespace {

namespace fs = std::filesystem;

class ThermalTest : public testing::Test {
 protected:
  void write(const std::string& file, const std::string& text) const {
    const fs::path path = folder_.file(file);
    fs::create_directories(path.parent_path());
    std::ofstream(path) << text << "\n";
  }
  void zone(int number, const std::string& type, int millidegrees) const {
    const std::string folder = "class/thermal/thermal_zone" + std::to_string(number) + "/";
    write(folder + "type", type);
    write(folder + "temp", std::to_string(millidegrees));
  }
  void trip(int zone, int number, const std::string& type, int millidegrees) const {
    const std::string file = "class/thermal/thermal_zone" + std::to_string(zone) + "/trip_point_" +
                             std::to_string(number);
    write(file + "_type", type);
    write(file + "_temp", std::to_string(millidegrees));
  }
  void cooling(int number, const std::string& type, int state) const {
    const std::string folder = "class/thermal/cooling_device" + std::to_string(number) + "/";
    write(folder + "type", type);
    write(folder + "cur_state", std::to_string(state));
  }
  ThermalReading read() const { return Thermal(folder_.path()).read(); }

  test::TemporaryFolder folder_;
};

TEST_F(ThermalTest, ABoardWithoutSensorsIsNeitherHotNorThrottled) {
  const ThermalReading reading = read();
  EXPECT_EQ(reading.zone, "");
  EXPECT_TRUE(std::isinf(reading.headroom_celsius));
  EXPECT_FALSE(reading.throttled);
  EXPECT_EQ(reading.cpu_limit, 1);
}

TEST_F(ThermalTest, TheZoneNearestToItsLimitCounts) {
  zone(0, "cpu-thermal", 71000);
  trip(0, 0, "active", 60000);  // a fan starts
  trip(0, 1, "passive", 95000);
  trip(0, 2, "critical", 105000);
  zone(1, "gpu-thermal", 70000);
  trip(1, 0, "critical", 90000);
  zone(2, "wifi", 80000);  // without a limit
  const ThermalReading reading = read();
  EXPECT_EQ(reading.zone, "gpu-thermal");
  EXPECT_DOUBLE_EQ(reading.celsius, 70);
  EXPECT_DOUBLE_EQ(reading.headroom_celsius, 20);
}

TEST_F(ThermalTest, WithoutLimitsTheHottestIsTold) {
  zone(0, "a", 40000);
  zone(1, "b", 55000);
  zone(2, "c", 50000);
  EXPECT_EQ(read().zone, "b");
  EXPECT_DOUBLE_EQ(read().celsius, 55);
}

TEST_F(ThermalTest, ReadsAnewEveryTime) {
  zone(0, "cpu-thermal", 50000);
  const Thermal thermal(folder_.path());
  EXPECT_DOUBLE_EQ(thermal.read().celsius, 50);
  zone(0, "cpu-thermal", 60500);
  EXPECT_DOUBLE_EQ(thermal.read().celsius, 60.5);
}

TEST_F(ThermalTest, NonsenseIsLeftOut) {
  zone(0, "absent", -256000);
  zone(1, "broken", 999999);
  write("class/thermal/thermal_zone2/type", "unreadable");
  write("class/thermal/thermal_zone2/temp", "I/O error");
  zone(3, "cpu-thermal", 50000);
  trip(3, 0, "passive", 0);  // nobody filled it in
  const ThermalReading reading = read();
  EXPECT_EQ(reading.zone, "cpu-thermal");
  EXPECT_TRUE(std::isinf(reading.headroom_celsius));
}

TEST_F(ThermalTest, OnlyWhatSlowsTheProcessorIsThrottling) {
  cooling(0, "pwm-fan", 3);
  EXPECT_FALSE(read().throttled);
  cooling(1, "cpufreq-cpu0", 0);
  EXPECT_FALSE(read().throttled);
  for (const char* type : {"cpufreq-cpu0", "thermal-cpufreq-0", "thermal-devfreq-0", "Processor"}) {
    cooling(1, type, 2);
    EXPECT_TRUE(read().throttled) << type;
  }
}

TEST_F(ThermalTest, TheLowestFrequencyLimitCounts) {
  write("devices/system/cpu/cpufreq/policy0/cpuinfo_max_freq", "2000000");
  write("devices/system/cpu/cpufreq/policy0/scaling_max_freq", "2000000");
  write("devices/system/cpu/cpufreq/policy4/cpuinfo_max_freq", "2400000");
  write("devices/system/cpu/cpufreq/policy4/scaling_max_freq", "1200000");
  EXPECT_DOUBLE_EQ(read().cpu_limit, 0.5);
}

}  // namespace
}  // namespace lcdm
