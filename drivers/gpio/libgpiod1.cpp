// GPIO by libgpiod 1.x (Debian 12, Ubuntu 22.04 and 24.04).
#include <cerrno>
#include <gpiod.h>
#include <utility>

#include "drivers/gpio/chip.h"

namespace lcdm {
namespace {

struct CloseChip {
  void operator()(gpiod_chip* chip) const { gpiod_chip_close(chip); }
};
using ChipPtr = std::unique_ptr<gpiod_chip, CloseChip>;

class Line final : public GpioLine {
 public:
  // `line` belongs to `chip` and is requested already.
  Line(ChipPtr chip, gpiod_line* line, GpioRequest request, std::string device)
      : chip_(std::move(chip)),
        line_(line),
        request_(std::move(request)),
        device_(std::move(device)) {}
  ~Line() override {
    if (request_.use == GpioUse::kOutput) gpiod_line_set_value(line_, 0);
    gpiod_line_release(line_);
  }

  Status set(bool active) override {
    if (gpiod_line_set_value(line_, active ? 1 : 0) == 0) return Status::ok();
    return gpio_line_error(request_, device_, errno);
  }

  Result<bool> get() override {
    const int value = gpiod_line_get_value(line_);
    if (value < 0) return gpio_line_error(request_, device_, errno);
    return value == 1;
  }

 private:
  const ChipPtr chip_;
  gpiod_line* const line_;
  const GpioRequest request_;
  const std::string device_;
};

int request_as(gpiod_line* line, const GpioRequest& request) {
  const int polarity = request.active_low ? GPIOD_LINE_REQUEST_FLAG_ACTIVE_LOW : 0;
  if (request.use == GpioUse::kOutput) {
    return gpiod_line_request_output_flags(line, kGpioConsumer, polarity, 0);
  }
  const int pull = request.active_low ? GPIOD_LINE_REQUEST_FLAG_BIAS_PULL_UP
                                      : GPIOD_LINE_REQUEST_FLAG_BIAS_PULL_DOWN;
  return gpiod_line_request_input_flags(line, kGpioConsumer, polarity | pull);
}

}  // namespace

Result<std::unique_ptr<GpioLine>> request_line_of_chip(const std::string& device,
                                                       const GpioRequest& request) {
  ChipPtr chip(gpiod_chip_open(device.c_str()));
  if (!chip) return gpio_chip_error(device, errno);
  gpiod_line* line = gpiod_chip_find_line(chip.get(), request.line.c_str());
  if (line == nullptr) return gpio_line_missing(request);
  if (request_as(line, request) != 0) return gpio_line_error(request, device, errno);
  return std::unique_ptr<GpioLine>(new Line(std::move(chip), line, request, device));
}

}  // namespace lcdm
