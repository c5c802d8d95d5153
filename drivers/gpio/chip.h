// One chip of many: what gpio.cpp asks of the version of libgpiod that the system has. Implemented
// by libgpiod1.cpp, libgpiod2.cpp or, without the library, none.cpp.
#pragma once

#include <memory>
#include <string>

#include "drivers/gpio/gpio.h"

namespace lcdm {

constexpr const char* kGpioConsumer = "lcdm";  // the name `gpioinfo` shows beside our lines

struct GpioRequest {
  std::string line;  // its name on the chip
  GpioUse use = GpioUse::kInput;
  bool active_low = false;
};

// `device`: /dev/gpiochipN. kNotFound: the chip has no such line.
Result<std::unique_ptr<GpioLine>> request_line_of_chip(const std::string& device,
                                                       const GpioRequest& request);

// The errors of both versions, by errno.
Status gpio_chip_error(const std::string& device, int error);
Status gpio_line_error(const GpioRequest& request, const std::string& device, int error);
Status gpio_line_missing(const GpioRequest& request);

}  // namespace lcdm
