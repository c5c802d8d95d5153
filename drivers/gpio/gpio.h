// Single GPIO lines, found by the names that the board's device tree gives them.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "firmware/base/status.h"

namespace lcdm {

// A line that is ours until it is dropped; an output is driven inactive first, which is its safe
// level. (A process that is killed cannot do so: the line then keeps its last level.) Belongs to
// one thread.
class GpioLine {
 public:
  virtual ~GpioLine() = default;
  GpioLine(const GpioLine&) = delete;
  GpioLine& operator=(const GpioLine&) = delete;

  // Outputs: drives the line.
  virtual Status set(bool active) = 0;
  // Whether the line is active now.
  virtual Result<bool> get() = 0;

 protected:
  GpioLine() = default;
};

enum class GpioUse : std::uint8_t {
  kOutput,  // begins inactive
  kInput,   // pulled towards inactive where the chip can do that
};

// `name`: as `gpioinfo` prints it; a leading '!' says that the line is active when it is low. All
// chips are looked through, in the order of their numbers. kNotFound: no such line, or no chip;
// kUnavailable: somebody else uses it; kUnsupported: built without libgpiod; kIoError.
Result<std::unique_ptr<GpioLine>> request_gpio_line(const std::string& name, GpioUse use);

}  // namespace lcdm
