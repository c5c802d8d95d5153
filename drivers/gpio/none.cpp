// GPIO where libgpiod is missing: every line is refused with the cure.
#include "drivers/gpio/chip.h"

namespace lcdm {

Result<std::unique_ptr<GpioLine>> request_line_of_chip(const std::string&,
                                                       const GpioRequest& request) {
  return Status::error(StatusCode::kUnsupported,
                       "gpio %s: this program was built without libgpiod: install libgpiod-dev and "
                       "build again, or leave [gpio] empty",
                       request.line.c_str());
}

}  // namespace lcdm
