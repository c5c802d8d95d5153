// GPIO by libgpiod 2.x.
#include <cerrno>
#include <gpiod.h>
#include <utility>

#include "drivers/gpio/chip.h"

namespace lcdm {
namespace {

template <auto free>
struct Free {
  template <typename T>
  void operator()(T* pointer) const {
    free(pointer);
  }
};
using ChipPtr = std::unique_ptr<gpiod_chip, Free<gpiod_chip_close>>;
using SettingsPtr = std::unique_ptr<gpiod_line_settings, Free<gpiod_line_settings_free>>;
using LinesPtr = std::unique_ptr<gpiod_line_config, Free<gpiod_line_config_free>>;
using NamePtr = std::unique_ptr<gpiod_request_config, Free<gpiod_request_config_free>>;
using RequestPtr = std::unique_ptr<gpiod_line_request, Free<gpiod_line_request_release>>;

class Line final : public GpioLine {
 public:
  Line(RequestPtr line, unsigned int offset, GpioRequest request, std::string device)
      : line_(std::move(line)),
        offset_(offset),
        request_(std::move(request)),
        device_(std::move(device)) {}
  ~Line() override {
    if (request_.use == GpioUse::kOutput) {
      gpiod_line_request_set_value(line_.get(), offset_, GPIOD_LINE_VALUE_INACTIVE);
    }
  }

  Status set(bool active) override {
    const gpiod_line_value value = active ? GPIOD_LINE_VALUE_ACTIVE : GPIOD_LINE_VALUE_INACTIVE;
    if (gpiod_line_request_set_value(line_.get(), offset_, value) == 0) return Status::ok();
    return gpio_line_error(request_, device_, errno);
  }

  Result<bool> get() override {
    const gpiod_line_value value = gpiod_line_request_get_value(line_.get(), offset_);
    if (value == GPIOD_LINE_VALUE_ERROR) return gpio_line_error(request_, device_, errno);
    return value == GPIOD_LINE_VALUE_ACTIVE;
  }

 private:
  const RequestPtr line_;
  const unsigned int offset_;
  const GpioRequest request_;
  const std::string device_;
};

// All null, errno set, where memory is short.
RequestPtr request_as(gpiod_chip* chip, unsigned int offset, const GpioRequest& request) {
  const SettingsPtr settings(gpiod_line_settings_new());
  const LinesPtr lines(gpiod_line_config_new());
  const NamePtr name(gpiod_request_config_new());
  if (!settings || !lines || !name) return nullptr;
  gpiod_line_settings_set_active_low(settings.get(), request.active_low);
  if (request.use == GpioUse::kOutput) {
    gpiod_line_settings_set_direction(settings.get(), GPIOD_LINE_DIRECTION_OUTPUT);
    gpiod_line_settings_set_output_value(settings.get(), GPIOD_LINE_VALUE_INACTIVE);
  } else {
    gpiod_line_settings_set_direction(settings.get(), GPIOD_LINE_DIRECTION_INPUT);
    gpiod_line_settings_set_bias(
        settings.get(), request.active_low ? GPIOD_LINE_BIAS_PULL_UP : GPIOD_LINE_BIAS_PULL_DOWN);
  }
  if (gpiod_line_config_add_line_settings(lines.get(), &offset, 1, settings.get()) != 0) {
    return nullptr;
  }
  gpiod_request_config_set_consumer(name.get(), kGpioConsumer);
  return RequestPtr(gpiod_chip_request_lines(chip, name.get(), lines.get()));
}

}  // namespace

Result<std::unique_ptr<GpioLine>> request_line_of_chip(const std::string& device,
                                                       const GpioRequest& request) {
  const ChipPtr chip(gpiod_chip_open(device.c_str()));
  if (!chip) return gpio_chip_error(device, errno);
  const int found = gpiod_chip_get_line_offset_from_name(chip.get(), request.line.c_str());
  if (found < 0) return gpio_line_missing(request);
  const auto offset = static_cast<unsigned int>(found);
  RequestPtr line = request_as(chip.get(), offset, request);
  if (!line) return gpio_line_error(request, device, errno);
  return std::unique_ptr<GpioLine>(new Line(std::move(line), offset, request, device));
}

}  // namespace lcdm
