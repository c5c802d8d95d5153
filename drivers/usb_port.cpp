#include "drivers/usb_port.h"

#include <cerrno>
#include <cstring>
#include <fcntl.h>
#include <libudev.h>
#include <linux/usbdevice_fs.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <thread>
#include <unistd.h>

namespace lcdm {

UsbPort::UsbPort() : udev_(udev_new()) {
  if (udev_ == nullptr) return;
  // "udev": after its rules have run, so that the node has its permissions.
  monitor_ = udev_monitor_new_from_netlink(udev_, "udev");
  if (monitor_ == nullptr) return;
  const bool heard =
      udev_monitor_filter_add_match_subsystem_devtype(monitor_, "video4linux", nullptr) >= 0 &&
      udev_monitor_enable_receiving(monitor_) >= 0;
  if (heard) return;
  udev_monitor_unref(monitor_);
  monitor_ = nullptr;
}

UsbPort::~UsbPort() {
  if (monitor_ != nullptr) udev_monitor_unref(monitor_);
  if (udev_ != nullptr) udev_unref(udev_);
}

bool UsbPort::wait_for_arrival(std::chrono::milliseconds timeout) {
  if (monitor_ == nullptr) {
    std::this_thread::sleep_for(timeout);
    return false;
  }
  pollfd descriptor{udev_monitor_get_fd(monitor_), POLLIN, 0};
  if (poll(&descriptor, 1, static_cast<int>(timeout.count())) <= 0) return false;
  return take_arrivals();
}

// Empties the queue of news. True: an arrival was among them.
bool UsbPort::take_arrivals() {
  bool arrived = false;
  while (udev_device* device = udev_monitor_receive_device(monitor_)) {
    const char* action = udev_device_get_action(device);
    arrived = arrived || (action != nullptr && std::strcmp(action, "add") == 0);
    udev_device_unref(device);
  }
  return arrived;
}

Status UsbPort::reset(const std::string& usb) {
  if (usb.empty()) return Status::error(StatusCode::kUnsupported, "the camera is not on USB");
  const int fd = open(usb.c_str(), O_WRONLY | O_CLOEXEC);
  if (fd < 0) return Status::system(errno, "%s: cannot open it to reset the port", usb.c_str());
  const int fault = ioctl(fd, USBDEVFS_RESET, nullptr) < 0 ? errno : 0;
  close(fd);
  if (fault != 0) return Status::system(fault, "%s: cannot reset the port", usb.c_str());
  return Status::ok();
}

}  // namespace lcdm
