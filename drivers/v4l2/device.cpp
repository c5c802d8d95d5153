#include "drivers/v4l2/device.h"

#include <cerrno>
#include <fcntl.h>
#include <sys/ioctl.h>
#include <unistd.h>

namespace lcdm {
namespace {

std::uint32_t capabilities_of(const v4l2_capability& capability) {
  const bool per_node = (capability.capabilities & V4L2_CAP_DEVICE_CAPS) != 0;
  return per_node ? capability.device_caps : capability.capabilities;
}

// Why this node cannot be our camera; null when it can.
const char* capability_fault(std::uint32_t capabilities) {
  constexpr std::uint32_t kCaptures = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_VIDEO_CAPTURE_MPLANE;
  if ((capabilities & kCaptures) == 0) {
    return "it captures no video (a metadata or output node?)";
  }
  if ((capabilities & V4L2_CAP_STREAMING) == 0) return "its driver cannot stream";
  return nullptr;
}

// What mends a refusal, where its errno tells.
const char* cure_of(int sys_errno) {
  switch (sys_errno) {
    case EBUSY:
      return " (another program holds the camera: close it)";
    case ENOSPC:
      return " (no room on its USB bus: a smaller [camera] width and height, a lower "
             "frames_per_second, format = \"MJPEG\", or a port of another bus)";
    default:
      return "";
  }
}

}  // namespace

Status V4l2Device::open(const std::string& path) {
  close();
  path_ = path;
  fd_ = ::open(path.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC);
  if (fd_ < 0) {
    if (errno == ENOENT || errno == ENODEV || errno == ENXIO) {
      return Status::error(
          StatusCode::kNotFound,
          "v4l2:%s: no such camera: is it plugged in? `lcdm probe` lists those that are",
          path.c_str());
    }
    if (errno == EACCES) {
      return Status::system(errno, "v4l2:%s: add this user to the group video", path.c_str());
    }
    return Status::system(errno, "v4l2:%s: cannot open", path.c_str());
  }
  const Status status = query();
  if (!status) close();
  return status;
}

Status V4l2Device::query() {
  v4l2_capability capability{};
  if (const int fault = control(VIDIOC_QUERYCAP, &capability); fault != 0) {
    if (fault != ENOTTY && fault != EINVAL) return failure(fault, "cannot ask what it is");
    return Status::error(StatusCode::kUnsupported, "v4l2:%s: this is no V4L2 device",
                         path_.c_str());
  }
  card_ = bounded_text(capability.card);
  driver_ = bounded_text(capability.driver);
  bus_ = bounded_text(capability.bus_info);
  const std::uint32_t capabilities = capabilities_of(capability);
  if (const char* missing = capability_fault(capabilities); missing != nullptr) {
    return Status::error(StatusCode::kUnsupported, "v4l2:%s (%.48s): %s", path_.c_str(),
                         card_.c_str(), missing);
  }
  queue_ = (capabilities & V4L2_CAP_VIDEO_CAPTURE) != 0 ? V4L2_BUF_TYPE_VIDEO_CAPTURE
                                                        : V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE;
  return Status::ok();
}

void V4l2Device::close() {
  if (fd_ >= 0) ::close(fd_);
  fd_ = -1;
}

int V4l2Device::control(unsigned long request, void* argument) const {
  int result = 0;
  do {
    result = ioctl(fd_, request, argument);
  } while (result < 0 && errno == EINTR);
  return result < 0 ? errno : 0;
}

Status V4l2Device::failure(int sys_errno, const char* what) const {
  if (sys_errno == ENODEV || sys_errno == ENXIO) {
    return Status::error(StatusCode::kDeviceGone, "v4l2:%s: the camera is gone", path_.c_str());
  }
  return Status::system(sys_errno, "v4l2:%s: %s%s", path_.c_str(), what, cure_of(sys_errno));
}

}  // namespace lcdm
