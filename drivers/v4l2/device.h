// One open /dev/video* node: its descriptor, what it says it is, and ioctls that signals do not
// interrupt.
#pragma once

#include <cstddef>
#include <cstdint>
#include <linux/videodev2.h>
#include <string>
#include <string_view>

#include "firmware/base/printable.h"
#include "firmware/base/status.h"

namespace lcdm {

// Opened by `open`, closed by `close` and by destruction. Used from one thread at a time.
class V4l2Device {
 public:
  V4l2Device() = default;
  ~V4l2Device() { close(); }
  V4l2Device(const V4l2Device&) = delete;
  V4l2Device& operator=(const V4l2Device&) = delete;

  // Opens a node or a link to one and asks what it is. kNotFound: it is not there; kIoError: no
  // permission; kUnsupported: no camera. Texts say the cure.
  Status open(const std::string& path);
  void close();

  int fd() const { return fd_; }
  const std::string& path() const { return path_; }
  const std::string& card() const { return card_; }      // the camera's name
  const std::string& driver() const { return driver_; }  // the kernel module
  const std::string& bus() const { return bus_; }        // where it is plugged in

  // The one queue we use: V4L2_BUF_TYPE_VIDEO_CAPTURE, or its multi-planar sister.
  std::uint32_t queue() const { return queue_; }
  bool multi_planar() const { return queue_ == V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE; }

  // 0, or the errno.
  int control(unsigned long request, void* argument) const;

  // What `sys_errno` of a request means: kDeviceGone where the device left, else kIoError, with the
  // cure where it tells one.
  Status failure(int sys_errno, const char* what) const;

 private:
  Status query();

  int fd_ = -1;
  std::uint32_t queue_ = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  std::string path_;
  std::string card_;
  std::string driver_;
  std::string bus_;
};

// A kernel's text field, which need not end in zero. Its words are the device's own.
template <std::size_t kSize>
std::string bounded_text(const std::uint8_t (&field)[kSize]) {
  const std::string_view text(reinterpret_cast<const char*>(field), kSize);
  return printable(text.substr(0, text.find('\0')));
}

}  // namespace lcdm
