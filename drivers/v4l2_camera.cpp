#include "drivers/v4l2_camera.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <fcntl.h>
#include <filesystem>
#include <linux/videodev2.h>
#include <optional>
#include <poll.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <system_error>
#include <thread>
#include <unistd.h>

#include "firmware/base/os.h"

namespace lcdm {
namespace {

namespace fs = std::filesystem;

// Beyond what the driver needs itself: one buffer in the mailbox, one with infer, one on the way.
constexpr std::uint32_t kBuffersOutside = 3;
constexpr std::uint32_t kLeastBuffers = 4;
constexpr int kMaxSide = 8192;
constexpr v4l2_buf_type kCapture = V4L2_BUF_TYPE_VIDEO_CAPTURE;

struct KnownFormat {
  std::uint32_t fourcc;
  PixelFormat pixel;
};
// In order of preference: uncompressed costs no decoding and no artefacts.
constexpr KnownFormat kKnownFormats[] = {{V4L2_PIX_FMT_YUYV, PixelFormat::kYuyv},
                                         {V4L2_PIX_FMT_MJPEG, PixelFormat::kMjpeg}};

// ioctl that a signal does not interrupt; 0 or the errno.
int control(int fd, unsigned long request, void* argument) {
  int result = 0;
  do {
    result = ioctl(fd, request, argument);
  } while (result < 0 && errno == EINTR);
  return result < 0 ? errno : 0;
}

std::uint32_t capabilities_of(const v4l2_capability& capability) {
  const bool per_node = (capability.capabilities & V4L2_CAP_DEVICE_CAPS) != 0;
  return per_node ? capability.device_caps : capability.capabilities;
}

// Why this node cannot be our camera; null when it can.
const char* capability_fault(std::uint32_t capabilities) {
  if ((capabilities & V4L2_CAP_VIDEO_CAPTURE) == 0) {
    return "it captures no single-planar video (a metadata or output node?)";
  }
  if ((capabilities & V4L2_CAP_STREAMING) == 0) return "its driver cannot stream";
  return nullptr;
}

template <std::size_t kSize>
std::string bounded_text(const std::uint8_t (&field)[kSize]) {
  const auto* text = reinterpret_cast<const char*>(field);
  return {text, strnlen(text, kSize)};
}

bool offers(int fd, std::uint32_t fourcc) {
  v4l2_fmtdesc description{};
  description.type = kCapture;
  constexpr std::uint32_t kMostFormats = 64;
  for (; description.index < kMostFormats; ++description.index) {
    if (control(fd, VIDIOC_ENUM_FMT, &description) != 0) return false;
    if (description.pixelformat == fourcc) return true;
  }
  return false;
}

// The highest rate the driver lists for this mode; empty when it lists none.
std::optional<float> listed_rate(int fd, std::uint32_t fourcc, int width, int height) {
  v4l2_frmivalenum interval{};
  interval.pixel_format = fourcc;
  interval.width = static_cast<std::uint32_t>(width);
  interval.height = static_cast<std::uint32_t>(height);
  std::optional<float> best;
  constexpr std::uint32_t kMostIntervals = 64;
  for (; interval.index < kMostIntervals; ++interval.index) {
    if (control(fd, VIDIOC_ENUM_FRAMEINTERVALS, &interval) != 0) break;
    const v4l2_fract& period =
        interval.type == V4L2_FRMIVAL_TYPE_DISCRETE ? interval.discrete : interval.stepwise.min;
    if (period.numerator == 0) continue;
    const float rate =
        static_cast<float>(period.denominator) / static_cast<float>(period.numerator);
    best = std::max(best.value_or(0), rate);
    if (interval.type != V4L2_FRMIVAL_TYPE_DISCRETE) break;
  }
  return best;
}

// The first known format that the camera offers at the wanted rate; else the first it offers.
const KnownFormat* choose_format(int fd, const CaptureRequest& request) {
  const KnownFormat* fallback = nullptr;
  for (const KnownFormat& format : kKnownFormats) {
    if (!offers(fd, format.fourcc)) continue;
    const auto rate = listed_rate(fd, format.fourcc, request.width, request.height);
    if (rate.value_or(request.frames_per_second) >= request.frames_per_second * 0.95F) {
      return &format;
    }
    if (fallback == nullptr) fallback = &format;
  }
  return fallback;
}

std::int64_t to_ns(const timeval& time) {
  return static_cast<std::int64_t>(time.tv_sec) * 1'000'000'000 +
         static_cast<std::int64_t>(time.tv_usec) * 1'000;
}

}  // namespace

std::vector<V4l2Node> list_v4l2_nodes() {
  std::vector<std::pair<int, std::string>> paths;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator("/dev", error)) {
    const std::string name = entry.path().filename().string();
    if (name.rfind("video", 0) != 0 || name.size() == 5) continue;
    char* end = nullptr;
    const long number = std::strtol(name.c_str() + 5, &end, 10);
    if (*end == '\0') paths.emplace_back(static_cast<int>(number), entry.path().string());
  }
  std::sort(paths.begin(), paths.end());

  std::vector<V4l2Node> nodes;
  for (const auto& [number, path] : paths) {
    V4l2Node node{path, "", false, ""};
    const int fd = open(path.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC);
    v4l2_capability capability{};
    if (fd < 0) {
      node.reason = errno == EACCES ? "no permission (add this user to the group video)"
                                    : std::generic_category().message(errno);
    } else if (const int fault = control(fd, VIDIOC_QUERYCAP, &capability); fault != 0) {
      node.reason = "not a V4L2 device: " + std::generic_category().message(fault);
    } else {
      node.card = bounded_text(capability.card);
      const char* missing = capability_fault(capabilities_of(capability));
      if (missing != nullptr) {
        node.reason = missing;
      } else if (!offers(fd, V4L2_PIX_FMT_YUYV) && !offers(fd, V4L2_PIX_FMT_MJPEG)) {
        node.reason = "it offers neither YUYV nor MJPEG";
      } else {
        node.usable = true;
      }
    }
    if (fd >= 0) close(fd);
    nodes.push_back(std::move(node));
  }
  return nodes;
}

V4l2Camera::V4l2Camera(std::string device) : device_(std::move(device)) {}

V4l2Camera::~V4l2Camera() { close_device(); }

Status V4l2Camera::configure(const CaptureRequest& request) {
  close_device();
  Status status = open_device();
  if (status) status = check_capabilities();
  if (status) status = set_format(request);
  if (status) status = set_rate(request.frames_per_second);
  if (status) status = map_buffers();
  if (!status) {
    close_device();
    return status;
  }
  model_ =
      CameraModel::from_field_of_view(format_.width, format_.height, request.assumed_field_of_view);
  return Status::ok();
}

CameraInfo V4l2Camera::info() const {
  char text[160];
  std::snprintf(text, sizeof(text), "%.64s, %s %dx%d at %.1f frames/s", card_.c_str(),
                to_string(format_.pixel), format_.width, format_.height,
                static_cast<double>(frames_per_second_));
  return {"v4l2:" + device_, text, frames_per_second_};
}

Status V4l2Camera::start() {
  for (std::size_t i = 0; i < buffers_.size(); ++i) {
    LCDM_RETURN_IF_ERROR(requeue(static_cast<int>(i)));
  }
  int type = kCapture;
  if (const int fault = control(fd_, VIDIOC_STREAMON, &type); fault != 0) {
    return failure(fault, "cannot start streaming (another program may hold the camera)");
  }
  streaming_ = true;
  first_frame_ = true;
  sequence_ = 0;
  return Status::ok();
}

void V4l2Camera::stop() {
  if (!streaming_) return;
  int type = kCapture;
  control(fd_, VIDIOC_STREAMOFF, &type);  // gives every buffer back to us; a gone device may refuse
  streaming_ = false;
}

Result<CapturedFrame> V4l2Camera::dequeue(std::chrono::milliseconds timeout) {
  const std::int64_t deadline =
      os::monotonic_ns() + std::chrono::duration_cast<std::chrono::nanoseconds>(timeout).count();
  v4l2_buffer buffer{};
  while (true) {
    LCDM_RETURN_IF_ERROR(wait_readable(deadline));
    buffer = {};
    buffer.type = kCapture;
    buffer.memory = V4L2_MEMORY_MMAP;
    const int fault = control(fd_, VIDIOC_DQBUF, &buffer);
    if (fault == 0) break;
    if (fault != EAGAIN) return failure(fault, "cannot take a frame");
    // Readable, yet nothing to take: rare, and not worth spinning on.
    if (os::monotonic_ns() >= deadline) return no_frame();
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  if (buffer.index >= buffers_.size()) {
    return Status::error(StatusCode::kIoError, "v4l2:%s: its driver answered with buffer %u of %zu",
                         device_.c_str(), buffer.index, buffers_.size());
  }

  const auto index = static_cast<int>(buffer.index);
  const Mapping& mapping = buffers_[buffer.index];
  const std::size_t needed =
      format_.pixel == PixelFormat::kMjpeg
          ? 1
          : static_cast<std::size_t>(format_.stride) * static_cast<std::size_t>(format_.height);
  const bool damaged = (buffer.flags & V4L2_BUF_FLAG_ERROR) != 0 || buffer.bytesused < needed ||
                       buffer.bytesused > mapping.length;
  const std::uint64_t sequence = extend_sequence(buffer.sequence);
  if (damaged) {
    LCDM_RETURN_IF_ERROR(requeue(index));
    return Status::error(StatusCode::kCorrupt, "v4l2:%s: damaged frame (%u bytes, flags %x)",
                         device_.c_str(), buffer.bytesused, buffer.flags);
  }

  CapturedFrame frame;
  frame.index = index;
  frame.view.format = format_;
  frame.view.data = static_cast<const std::uint8_t*>(mapping.memory);
  frame.view.bytes = buffer.bytesused;
  frame.view.meta.sequence = sequence;
  const bool monotonic =
      (buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) == V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
  frame.view.meta.sensor_ns = monotonic ? to_ns(buffer.timestamp) : os::monotonic_ns();
  frame.view.meta.unix_ns = frame.view.meta.sensor_ns + os::unix_offset_ns();
  return frame;
}

Status V4l2Camera::requeue(int index) {
  if (index < 0 || index >= buffer_count()) {
    return Status::error(StatusCode::kInvalidInput, "v4l2:%s: no buffer %d", device_.c_str(),
                         index);
  }
  v4l2_buffer buffer{};
  buffer.type = kCapture;
  buffer.memory = V4L2_MEMORY_MMAP;
  buffer.index = static_cast<std::uint32_t>(index);
  if (const int fault = control(fd_, VIDIOC_QBUF, &buffer); fault != 0) {
    return failure(fault, "cannot give a buffer back");
  }
  return Status::ok();
}

Status V4l2Camera::open_device() {
  fd_ = open(device_.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC);
  if (fd_ >= 0) return Status::ok();
  if (errno == ENOENT || errno == ENODEV || errno == ENXIO) {
    return Status::error(
        StatusCode::kNotFound,
        "v4l2:%s: no such camera: is it plugged in? `ls /dev/v4l/by-id` lists them",
        device_.c_str());
  }
  if (errno == EACCES) {
    return Status::system(errno, "v4l2:%s: add this user to the group video", device_.c_str());
  }
  return Status::system(errno, "v4l2:%s: cannot open", device_.c_str());
}

Status V4l2Camera::check_capabilities() {
  v4l2_capability capability{};
  if (const int fault = control(fd_, VIDIOC_QUERYCAP, &capability); fault != 0) {
    if (fault == ENODEV) return failure(fault, "cannot ask what it is");
    return Status::error(StatusCode::kUnsupported, "v4l2:%s: this is no V4L2 device",
                         device_.c_str());
  }
  card_ = bounded_text(capability.card);
  if (const char* missing = capability_fault(capabilities_of(capability)); missing != nullptr) {
    return Status::error(StatusCode::kUnsupported, "v4l2:%s (%.48s): %s", device_.c_str(),
                         card_.c_str(), missing);
  }
  return Status::ok();
}

// Asks for a format and takes what comes back, if it makes sense.
Status V4l2Camera::set_format(const CaptureRequest& request) {
  const KnownFormat* chosen = choose_format(fd_, request);
  if (chosen == nullptr) {
    return Status::error(StatusCode::kUnsupported, "v4l2:%s (%.48s): offers neither YUYV nor MJPEG",
                         device_.c_str(), card_.c_str());
  }
  v4l2_format format{};
  format.type = kCapture;
  format.fmt.pix.width = static_cast<std::uint32_t>(request.width);
  format.fmt.pix.height = static_cast<std::uint32_t>(request.height);
  format.fmt.pix.pixelformat = chosen->fourcc;
  format.fmt.pix.field = V4L2_FIELD_NONE;
  if (const int fault = control(fd_, VIDIOC_S_FMT, &format); fault != 0) {
    return failure(fault, "cannot set a format");
  }
  const v4l2_pix_format& pix = format.fmt.pix;
  const auto width = static_cast<int>(std::min<std::uint32_t>(pix.width, kMaxSide + 1));
  const auto height = static_cast<int>(std::min<std::uint32_t>(pix.height, kMaxSide + 1));
  const int packed = packed_stride(chosen->pixel, width);
  const auto stride = static_cast<int>(std::min<std::uint32_t>(pix.bytesperline, 8 * kMaxSide));
  const bool sane = pix.pixelformat == chosen->fourcc && width >= 2 && height >= 2 &&
                    width <= kMaxSide && height <= kMaxSide && (packed == 0 || stride >= packed);
  if (!sane) {
    return Status::error(StatusCode::kUnsupported,
                         "v4l2:%s: asked for %s %dx%d, the driver answered %ux%u, %u bytes a row: "
                         "set [camera] width and height to a mode of `v4l2-ctl --list-formats-ext`",
                         device_.c_str(), to_string(chosen->pixel), request.width, request.height,
                         pix.width, pix.height, pix.bytesperline);
  }
  format_ = {chosen->pixel, width, height, packed == 0 ? 0 : stride};
  return Status::ok();
}

Status V4l2Camera::set_rate(float frames_per_second) {
  // In low light many cameras would rather halve the rate than darken the picture; robots would
  // not. Not every camera has the control.
  v4l2_control steady{V4L2_CID_EXPOSURE_AUTO_PRIORITY, 0};
  control(fd_, VIDIOC_S_CTRL, &steady);

  v4l2_streamparm parameters{};
  parameters.type = kCapture;
  parameters.parm.capture.timeperframe.numerator = 1000;
  parameters.parm.capture.timeperframe.denominator =
      static_cast<std::uint32_t>(frames_per_second * 1000);
  frames_per_second_ = 0;
  if (control(fd_, VIDIOC_S_PARM, &parameters) != 0) return Status::ok();  // fixed rate
  const v4l2_fract& period = parameters.parm.capture.timeperframe;
  if (period.numerator != 0) {
    frames_per_second_ =
        static_cast<float>(period.denominator) / static_cast<float>(period.numerator);
  }
  return Status::ok();
}

Status V4l2Camera::map_buffers() {
  v4l2_control least{V4L2_CID_MIN_BUFFERS_FOR_CAPTURE, 1};
  if (control(fd_, VIDIOC_G_CTRL, &least) != 0) least.value = 1;
  v4l2_requestbuffers request{};
  request.type = kCapture;
  request.memory = V4L2_MEMORY_MMAP;
  request.count = std::max(
      kLeastBuffers, static_cast<std::uint32_t>(std::clamp(least.value, 1, 16)) + kBuffersOutside);
  if (const int fault = control(fd_, VIDIOC_REQBUFS, &request); fault != 0) {
    return failure(fault, "cannot reserve buffers (another program may hold the camera)");
  }
  // The driver may give fewer. Two is the least with which it can fill one while we hold one.
  if (request.count < 2 || request.count > 32) {
    return Status::error(StatusCode::kUnsupported, "v4l2:%s: the driver gives %u buffers",
                         device_.c_str(), request.count);
  }
  for (std::uint32_t i = 0; i < request.count; ++i) {
    v4l2_buffer buffer{};
    buffer.type = kCapture;
    buffer.memory = V4L2_MEMORY_MMAP;
    buffer.index = i;
    if (const int fault = control(fd_, VIDIOC_QUERYBUF, &buffer); fault != 0) {
      return failure(fault, "cannot ask for a buffer");
    }
    void* memory = mmap(nullptr, buffer.length, PROT_READ | PROT_WRITE, MAP_SHARED, fd_,
                        static_cast<off_t>(buffer.m.offset));
    if (memory == MAP_FAILED) return failure(errno, "cannot map a buffer");
    buffers_.push_back({memory, buffer.length});
  }
  return Status::ok();
}

void V4l2Camera::close_device() {
  stop();
  for (const Mapping& mapping : buffers_) munmap(mapping.memory, mapping.length);
  buffers_.clear();
  if (fd_ >= 0) close(fd_);
  fd_ = -1;
}

// Waits until a frame can be taken: kTimeout at the deadline.
Status V4l2Camera::wait_readable(std::int64_t deadline_ns) const {
  while (true) {
    const std::int64_t left = deadline_ns - os::monotonic_ns();
    pollfd descriptor{fd_, POLLIN, 0};
    const int ready = poll(
        &descriptor, 1, static_cast<int>(std::max<std::int64_t>(0, (left + 999'999) / 1'000'000)));
    if (ready < 0 && errno != EINTR) return failure(errno, "cannot wait for a frame");
    // An error or hang-up is told apart by what DQBUF then says.
    if (ready > 0) return Status::ok();
    if (left <= 0) return no_frame();
  }
}

Status V4l2Camera::no_frame() const {
  return Status::error(StatusCode::kTimeout, "v4l2:%s: no frame in time", device_.c_str());
}

Status V4l2Camera::failure(int sys_errno, const char* what) const {
  if (sys_errno == ENODEV || sys_errno == ENXIO) {
    return Status::error(StatusCode::kDeviceGone, "v4l2:%s: the camera is gone", device_.c_str());
  }
  return Status::system(sys_errno, "v4l2:%s: %s", device_.c_str(), what);
}

// The driver's 32-bit count continued past its wrap; a driver that does not count is counted for.
std::uint64_t V4l2Camera::extend_sequence(std::uint32_t sequence) {
  if (!first_frame_) {
    const std::uint32_t step = sequence - last_sequence_;
    sequence_ += step == 0 ? 1 : step;
  }
  first_frame_ = false;
  last_sequence_ = sequence;
  return sequence_;
}

}  // namespace lcdm
