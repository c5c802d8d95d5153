// Where a camera is plugged in: how the pipeline waits for one to arrive and resets one that hangs.
#pragma once

#include <chrono>
#include <string>

#include "firmware/base/status.h"

namespace lcdm {

// Used on the capture thread only, and only while no camera streams: both may allocate and block.
class CameraPort {
 public:
  virtual ~CameraPort() = default;

  // Waits at most `timeout`. True: a device has arrived since the last call, so that opening the
  // camera may work now.
  virtual bool wait_for_arrival(std::chrono::milliseconds timeout) = 0;

  // Resets the USB device, as if it were unplugged and plugged in again. `usb` is CameraInfo::usb
  // of a closed camera. Takes up to some seconds. kUnsupported: it is not on USB.
  virtual Status reset(const std::string& usb) = 0;
};

}  // namespace lcdm
