// Where a camera is plugged in: the kernel's news of cameras, by udev, and the reset of a USB port.
#pragma once

#include <memory>

#include "firmware/pipeline/camera_port.h"

struct udev;
struct udev_monitor;

namespace lcdm {

// Hears of every video device that arrives from the moment it is made. Where udev does not run it
// hears nothing, and waiting is no more than time passing. Threads: as CameraPort.
class UsbPort final : public CameraPort {
 public:
  UsbPort();
  ~UsbPort() override;
  UsbPort(const UsbPort&) = delete;
  UsbPort& operator=(const UsbPort&) = delete;

  bool wait_for_arrival(std::chrono::milliseconds timeout) override;
  // Needs write permission on the device's node. Only root has it, unless a udev rule says
  // otherwise: ours (systemd/lcdm.udev) gives that of a USB camera to the group `video`.
  Status reset(const std::string& usb) override;

 private:
  bool take_arrivals();

  udev* udev_ = nullptr;
  udev_monitor* monitor_ = nullptr;  // null: nothing is heard
};

}  // namespace lcdm
