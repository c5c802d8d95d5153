#include "drivers/gpio/gpio.h"

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <system_error>
#include <vector>

#include "drivers/gpio/chip.h"
#include "firmware/base/folder.h"

namespace lcdm {
namespace {

// /dev/gpiochip0, 1, ... in the order of their numbers.
std::vector<std::string> chip_devices() {
  constexpr const char* kPrefix = "/dev/gpiochip";
  const auto all = list_folder("/dev");
  if (!all) return {};
  std::vector<std::string> devices;
  for (const std::filesystem::path& path : *all) {
    if (path.string().rfind(kPrefix, 0) == 0) devices.push_back(path.string());
  }
  std::sort(devices.begin(), devices.end(), [](const std::string& a, const std::string& b) {
    return a.size() != b.size() ? a.size() < b.size() : a < b;
  });
  return devices;
}

}  // namespace

Status gpio_chip_error(const std::string& device, int error) {
  return Status::system(error, "gpio: cannot open %s (is the user in the group gpio?)",
                        device.c_str());
}

Status gpio_line_error(const GpioRequest& request, const std::string& device, int error) {
  if (error == EBUSY) {
    return Status::error(StatusCode::kUnavailable,
                         "gpio %s: another program or driver uses it on %s (gpioinfo says which)",
                         request.line.c_str(), device.c_str());
  }
  return Status::system(error, "gpio %s on %s", request.line.c_str(), device.c_str());
}

Status gpio_line_missing(const GpioRequest& request) {
  return Status::error(StatusCode::kNotFound,
                       "gpio %s: no chip has a line of that name (gpioinfo lists them)",
                       request.line.c_str());
}

Result<std::unique_ptr<GpioLine>> request_gpio_line(const std::string& name, GpioUse use) {
  const bool active_low = name.substr(0, 1) == "!";
  const GpioRequest request{active_low ? name.substr(1) : name, use, active_low};
  const std::vector<std::string> devices = chip_devices();
  Status failed =
      Status::error(StatusCode::kNotFound, "gpio %s: this machine has no GPIO chip", name.c_str());
  for (const std::string& device : devices) {
    auto line = request_line_of_chip(device, request);
    if (line || line.code() == StatusCode::kUnavailable ||
        line.code() == StatusCode::kUnsupported) {
      return line;
    }
    // A chip that could not be asked says more than one without the line.
    if (failed.code() == StatusCode::kNotFound) failed = line.status();
  }
  return failed;
}

}  // namespace lcdm
