#include "tests/support/fake_v4l2.h"

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <deque>
#include <fcntl.h>
#include <filesystem>
#include <linux/usbdevice_fs.h>
#include <map>
#include <mutex>
#include <poll.h>
#include <string>
#include <sys/stat.h>
#include <umockdev.h>
#include <unistd.h>
#include <vector>

#include "firmware/base/check.h"

namespace lcdm::test {
namespace {

constexpr std::uint32_t kPage = 4096;

bool is_multi_planar(const FakeV4l2::Behaviour& behaviour) {
  return (behaviour.capabilities & V4L2_CAP_VIDEO_CAPTURE_MPLANE) != 0;
}

std::uint32_t stride_of(const FakeV4l2::Behaviour& behaviour) {
  switch (behaviour.fourcc) {
    case V4L2_PIX_FMT_MJPEG:
      return 0;
    case V4L2_PIX_FMT_NV12:
    case V4L2_PIX_FMT_NV21:
    case V4L2_PIX_FMT_GREY:
      return behaviour.width + behaviour.row_padding;
    case V4L2_PIX_FMT_RGB24:
    case V4L2_PIX_FMT_BGR24:
      return behaviour.width * 3 + behaviour.row_padding;
    default:
      return behaviour.width * 2 + behaviour.row_padding;
  }
}

std::uint32_t image_bytes(const FakeV4l2::Behaviour& behaviour) {
  const std::uint32_t stride = stride_of(behaviour);
  const bool chroma_rows =
      behaviour.fourcc == V4L2_PIX_FMT_NV12 || behaviour.fourcc == V4L2_PIX_FMT_NV21;
  if (stride == 0) return behaviour.width * behaviour.height;
  return stride * behaviour.height * (chroma_rows ? 3 : 2) / 2;
}

std::uint32_t buffer_bytes(const FakeV4l2::Behaviour& behaviour) {
  return behaviour.data_offset + image_bytes(behaviour);
}

std::uint32_t buffer_stride(const FakeV4l2::Behaviour& behaviour) {
  return (buffer_bytes(behaviour) + kPage - 1) / kPage * kPage;
}

}  // namespace

// Shared between the test's thread and umockdev's, which answers the ioctls.
struct FakeV4l2::State {
  mutable std::mutex mutex;
  Behaviour behaviour;
  std::deque<std::uint32_t> queued;
  std::uint32_t delivered = 0;  // last
  std::uint32_t granted = 0;
  std::uint32_t sequence = 0;
  int requests = 0;
  std::map<std::uint32_t, int> controls;
  std::optional<v4l2_fract> period_asked;
  bool subscribed = false;
  bool event_pending = false;
  int usb_resets = 0;
  int backing = -1;
  UMockdevTestbed* testbed = nullptr;
  UMockdevIoctlBase* handler = nullptr;

  // `planes` is what a multi-planar v4l2_buffer points to, else null.
  int handle(unsigned request, void* argument, v4l2_plane* planes);
  int handle_mode(unsigned request, void* argument);
  int set_format(v4l2_format& format) const;
  int dequeue(v4l2_buffer& buffer, v4l2_plane* planes);
  std::vector<std::uint8_t> picture_of(std::uint32_t number) const;
};

namespace {

// GObject carries no C++ pointer: one fake per process at a time, as there is one /dev/video0.
FakeV4l2::State* g_state = nullptr;

std::size_t argument_size(unsigned long request) { return (request >> 16) & 0x3FFF; }

bool is_buffer_request(gulong request) {
  return request == VIDIOC_QUERYBUF || request == VIDIOC_QBUF || request == VIDIOC_DQBUF;
}

gboolean on_ioctl(UMockdevIoctlBase* /*base*/, UMockdevIoctlClient* client) {
  const gulong request = umockdev_ioctl_client_get_request(client);
  if (request == USBDEVFS_RESET) {
    const std::lock_guard lock(g_state->mutex);
    ++g_state->usb_resets;
    umockdev_ioctl_client_complete(client, 0, 0);
    return TRUE;
  }
  UMockdevIoctlData* pointer = umockdev_ioctl_client_get_arg(client);
  UMockdevIoctlData* data =
      umockdev_ioctl_data_resolve(pointer, 0, argument_size(request), nullptr);
  UMockdevIoctlData* planes = nullptr;
  if (data != nullptr && is_buffer_request(request) && is_multi_planar(g_state->behaviour)) {
    planes = umockdev_ioctl_data_resolve(data, offsetof(v4l2_buffer, m.planes), sizeof(v4l2_plane),
                                         nullptr);
  }
  const int fault =
      data == nullptr
          ? EFAULT
          : g_state->handle(
                static_cast<unsigned>(request), data->data,
                planes == nullptr ? nullptr : reinterpret_cast<v4l2_plane*>(planes->data));
  if (planes != nullptr) umockdev_ioctl_data_unref(planes);
  if (data != nullptr) umockdev_ioctl_data_unref(data);
  umockdev_ioctl_client_complete(client, fault == 0 ? 0 : -1, fault);
  return TRUE;
}

constexpr const char* kUsbDevice = "/devices/fake/usb1/1-1";

std::string video_path(bool on_usb) {
  return (on_usb ? std::string(kUsbDevice) + "/1-1:1.0" : std::string("/devices/fake")) +
         "/video4linux/video0";
}

std::string device_description(bool on_usb) {
  std::string text;
  if (on_usb) {
    text = "P: " + std::string(kUsbDevice) +
           "\nN: bus/usb/001/004\nE: SUBSYSTEM=usb\nE: DEVTYPE=usb_device\n"
           "E: DEVNAME=/dev/bus/usb/001/004\nE: MAJOR=189\nE: MINOR=3\n"
           "A: busnum=1\\n\nA: devnum=4\\n\nA: serial=F00D\\n\nA: speed=480\\n\n"
           "A: version= 3.20\\n\n\nP: " +
           std::string(kUsbDevice) + "/1-1:1.0\nE: SUBSYSTEM=usb\nE: DEVTYPE=usb_interface\n\n";
  }
  // Contents (N: with bytes) make the node a file, so that mmap on it works.
  text += "P: " + video_path(on_usb) + "\nN: video0=" + std::string(32, '0') +
          "\nE: SUBSYSTEM=video4linux\nE: DEVNAME=/dev/video0\nE: MAJOR=81\nE: MINOR=0\n"
          "A: name=fake\n";
  if (on_usb) text += "L: device=../../../1-1:1.0\n";
  return text + "\n";
}

// As udev makes them.
void make_link(const std::string& link) {
  std::filesystem::create_directories(std::filesystem::path(link).parent_path());
  std::filesystem::create_symlink("../../video0", link);
}

}  // namespace

bool umockdev_active() {
  const char* preloaded = std::getenv("LD_PRELOAD");  // NOLINT(concurrency-mt-unsafe): one thread
  return preloaded != nullptr && std::strstr(preloaded, "umockdev") != nullptr;
}

FakeV4l2::FakeV4l2(const Behaviour& behaviour) : state_(std::make_unique<State>()) {
  LCDM_CHECK(g_state == nullptr);
  g_state = state_.get();
  state_->behaviour = behaviour;
  state_->sequence = behaviour.first_sequence;
  state_->testbed = umockdev_testbed_new();
  GError* error = nullptr;
  LCDM_CHECK(umockdev_testbed_add_from_string(
      state_->testbed, device_description(behaviour.on_usb).c_str(), &error));
  char* root = umockdev_testbed_get_root_dir(state_->testbed);
  const std::string file = std::string(root) + kPath;
  make_link(std::string(root) + kLink);
  g_free(root);
  state_->backing = open(file.c_str(), O_RDWR | O_CLOEXEC);
  LCDM_CHECK(state_->backing >= 0);

  state_->handler = UMOCKDEV_IOCTL_BASE(g_object_new(umockdev_ioctl_base_get_type(), nullptr));
  g_signal_connect(state_->handler, "handle-ioctl", G_CALLBACK(on_ioctl), nullptr);
  LCDM_CHECK(umockdev_testbed_attach_ioctl(state_->testbed, kPath, state_->handler, &error));
  LCDM_CHECK(umockdev_testbed_attach_ioctl(state_->testbed, kLink, state_->handler, &error));
  if (!behaviour.on_usb) return;
  LCDM_CHECK(umockdev_testbed_attach_ioctl(state_->testbed, kUsbPath, state_->handler, &error));
}

FakeV4l2::~FakeV4l2() {
  umockdev_testbed_detach_ioctl(state_->testbed, kPath, nullptr);
  umockdev_testbed_detach_ioctl(state_->testbed, kLink, nullptr);
  g_object_unref(state_->handler);
  g_object_unref(state_->testbed);
  close(state_->backing);
  g_state = nullptr;
}

void FakeV4l2::set_behaviour(const Behaviour& behaviour) {
  const std::lock_guard lock(state_->mutex);
  state_->behaviour = behaviour;
}

int FakeV4l2::buffers_with_driver() const {
  const std::lock_guard lock(state_->mutex);
  return static_cast<int>(state_->queued.size());
}

std::optional<int> FakeV4l2::control(std::uint32_t id) const {
  const std::lock_guard lock(state_->mutex);
  const auto found = state_->controls.find(id);
  return found == state_->controls.end() ? std::nullopt : std::optional(found->second);
}

std::optional<v4l2_fract> FakeV4l2::period_asked() const {
  const std::lock_guard lock(state_->mutex);
  return state_->period_asked;
}

void FakeV4l2::change_source() {
  const std::lock_guard lock(state_->mutex);
  state_->event_pending = state_->subscribed;
}

void FakeV4l2::announce(const char* action) {
  const std::string path = "/sys" + video_path(state_->behaviour.on_usb);
  umockdev_testbed_uevent(state_->testbed, path.c_str(), action);
}

void FakeV4l2::close_to_everybody() {
  char* root = umockdev_testbed_get_root_dir(state_->testbed);
  const std::string socket = root + (std::string("/ioctl") + kPath);
  // The rest of the system stays visible, and umockdev connects also when it could not open.
  LCDM_CHECK(chmod(root, 0755) == 0 && chmod(socket.c_str(), 0666) == 0);
  g_free(root);
  LCDM_CHECK(fchmod(state_->backing, 0) == 0);
}

int FakeV4l2::usb_resets() const {
  const std::lock_guard lock(state_->mutex);
  return state_->usb_resets;
}

namespace {

int list_range(const FakeV4l2::Range& range, v4l2_frmsizeenum& size) {
  if (size.index != 0) return EINVAL;
  size.type = V4L2_FRMSIZE_TYPE_STEPWISE;
  size.stepwise = {range.least.width,  range.most.width,  range.step,
                   range.least.height, range.most.height, range.step};
  return 0;
}

int list_rate(const FakeV4l2::Range& range, v4l2_frmivalenum& interval) {
  const auto fits = [&range](std::uint32_t side, std::uint32_t least, std::uint32_t most) {
    return side >= least && side <= most && (side - least) % range.step == 0;
  };
  if (!fits(interval.width, range.least.width, range.most.width) ||
      !fits(interval.height, range.least.height, range.most.height)) {
    return EINVAL;
  }
  interval.type = V4L2_FRMIVAL_TYPE_DISCRETE;
  interval.discrete = {interval.width * interval.height, range.pixels_per_second};
  return 0;
}

}  // namespace

// What the driver offers and how it is set.
int FakeV4l2::State::handle_mode(unsigned request, void* argument) {
  switch (request) {
    case VIDIOC_QUERYCAP: {
      auto& capability = *static_cast<v4l2_capability*>(argument);
      capability = {};
      std::strcpy(reinterpret_cast<char*>(capability.card), "fake camera");
      std::strcpy(reinterpret_cast<char*>(capability.driver), "fake");
      capability.capabilities = behaviour.capabilities | V4L2_CAP_DEVICE_CAPS;
      capability.device_caps = behaviour.capabilities;
      return 0;
    }
    case VIDIOC_ENUM_FMT: {
      auto& format = *static_cast<v4l2_fmtdesc*>(argument);
      if (format.index > behaviour.raw_formats) return EINVAL;
      const bool ours = format.index == behaviour.raw_formats;
      format.pixelformat = ours ? behaviour.fourcc : V4L2_PIX_FMT_SRGGB10;
      return 0;
    }
    case VIDIOC_ENUM_FRAMESIZES: {
      auto& size = *static_cast<v4l2_frmsizeenum*>(argument);
      if (behaviour.range) return list_range(*behaviour.range, size);
      if (size.index >= behaviour.sizes.size()) return EINVAL;
      size.type = V4L2_FRMSIZE_TYPE_DISCRETE;
      size.discrete = {behaviour.sizes[size.index].width, behaviour.sizes[size.index].height};
      return 0;
    }
    case VIDIOC_ENUM_FRAMEINTERVALS: {
      auto& interval = *static_cast<v4l2_frmivalenum*>(argument);
      if (interval.index != 0) return EINVAL;
      if (behaviour.range) return list_rate(*behaviour.range, interval);
      for (const Size& size : behaviour.sizes) {
        if (size.width != interval.width || size.height != interval.height) continue;
        interval.type = V4L2_FRMIVAL_TYPE_DISCRETE;
        interval.discrete = {1, size.frames_per_second};
        return 0;
      }
      return EINVAL;
    }
    case VIDIOC_S_FMT:
      return set_format(*static_cast<v4l2_format*>(argument));
    case VIDIOC_S_PARM:
      period_asked = static_cast<v4l2_streamparm*>(argument)->parm.capture.timeperframe;
      [[fallthrough]];
    case VIDIOC_G_PARM:
      static_cast<v4l2_streamparm*>(argument)->parm.capture.timeperframe = {1, behaviour.rate};
      return 0;
    case VIDIOC_S_CTRL: {
      auto& control = *static_cast<v4l2_control*>(argument);
      const auto& known = behaviour.controls;
      if (std::find(known.begin(), known.end(), control.id) == known.end()) return EINVAL;
      control.value = std::min(control.value, behaviour.most_of_a_control);
      controls[control.id] = control.value;
      return 0;
    }
    default:
      return ENOTTY;
  }
}

int FakeV4l2::State::set_format(v4l2_format& format) const {
  if (is_multi_planar(behaviour) != (format.type == V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE)) {
    return EINVAL;
  }
  if (is_multi_planar(behaviour)) {
    v4l2_pix_format_mplane& pix = format.fmt.pix_mp;
    pix.pixelformat = behaviour.fourcc;
    pix.width = behaviour.width;
    pix.height = behaviour.height;
    pix.num_planes = static_cast<std::uint8_t>(behaviour.planes);
    pix.plane_fmt[0].bytesperline = stride_of(behaviour);
    pix.plane_fmt[0].sizeimage = image_bytes(behaviour);
    return 0;
  }
  v4l2_pix_format& pix = format.fmt.pix;
  pix.pixelformat = behaviour.fourcc;
  pix.width = behaviour.width;
  pix.height = behaviour.height;
  pix.bytesperline = stride_of(behaviour);
  pix.sizeimage = image_bytes(behaviour);
  return 0;
}

int FakeV4l2::State::handle(unsigned request, void* argument, v4l2_plane* planes) {
  const std::lock_guard lock(mutex);
  if (const int refusal = behaviour.refuse(request); refusal != 0) return refusal;
  switch (request) {
    case VIDIOC_REQBUFS: {
      auto& buffers = *static_cast<v4l2_requestbuffers*>(argument);
      granted = buffers.count = std::min(buffers.count, behaviour.most_buffers);
      queued.clear();
      return ftruncate(backing, static_cast<off_t>(granted) * buffer_stride(behaviour)) == 0 ? 0
                                                                                             : EIO;
    }
    case VIDIOC_EXPBUF: {
      if (!behaviour.shares_buffers) return ENOTTY;
      auto& shared = *static_cast<v4l2_exportbuffer*>(argument);
      shared.fd = fcntl(backing, F_DUPFD_CLOEXEC, 0);
      return shared.fd >= 0 ? 0 : EMFILE;
    }
    case VIDIOC_QUERYBUF: {
      auto& buffer = *static_cast<v4l2_buffer*>(argument);
      const std::uint32_t offset = buffer.index * buffer_stride(behaviour);
      buffer.flags = behaviour.stamp_flags;
      if (planes != nullptr) {
        planes->length = buffer_bytes(behaviour);
        planes->m.mem_offset = offset;
        return 0;
      }
      buffer.length = buffer_bytes(behaviour);
      buffer.m.offset = offset;
      return 0;
    }
    case VIDIOC_QBUF: {
      const std::uint32_t index = static_cast<v4l2_buffer*>(argument)->index;
      if (index >= granted) return EINVAL;
      queued.push_back(index);
      return 0;
    }
    case VIDIOC_DQBUF:
      return dequeue(*static_cast<v4l2_buffer*>(argument), planes);
    case VIDIOC_SUBSCRIBE_EVENT:
      subscribed =
          static_cast<const v4l2_event_subscription*>(argument)->type == V4L2_EVENT_SOURCE_CHANGE;
      return subscribed ? 0 : EINVAL;
    case VIDIOC_DQEVENT:
      if (!event_pending) return ENOENT;
      event_pending = false;
      static_cast<v4l2_event*>(argument)->type = V4L2_EVENT_SOURCE_CHANGE;
      return 0;
    case VIDIOC_STREAMON:
      return 0;
    case VIDIOC_STREAMOFF:
      queued.clear();
      return 0;
    default:
      return handle_mode(request, argument);
  }
}

int FakeV4l2::State::dequeue(v4l2_buffer& buffer, v4l2_plane* planes) {
  const Answer answer = behaviour.answer(requests++);
  if (answer == Answer::kIoError) return EIO;
  if (answer == Answer::kGone) return ENODEV;
  if (answer == Answer::kLostFrame) ++sequence;
  const bool none = answer == Answer::kNothing || answer == Answer::kLostFrame;
  if (none || queued.empty()) return EAGAIN;

  if (answer != Answer::kSameAgain) {
    delivered = queued.front();
    queued.pop_front();
  }
  buffer.index = delivered;
  const std::vector<std::uint8_t> picture = picture_of(sequence);
  const auto offset = static_cast<off_t>(buffer.index) * buffer_stride(behaviour);
  if (pwrite(backing, picture.data(), picture.size(), offset + behaviour.data_offset) < 0) {
    return EIO;
  }
  auto bytes = static_cast<std::uint32_t>(behaviour.data_offset + picture.size());
  if (answer == Answer::kShortFrame) bytes = 0;
  if (answer == Answer::kHugeFrame) bytes = 0x7FFFFFFF;
  (planes != nullptr ? planes->bytesused : buffer.bytesused) = bytes;
  if (planes != nullptr) planes->data_offset = behaviour.data_offset;
  if (answer == Answer::kWildIndex) buffer.index = 1000;
  buffer.flags = behaviour.stamp_flags;
  if (answer == Answer::kErrorFlag) buffer.flags |= V4L2_BUF_FLAG_ERROR;
  buffer.sequence = sequence++;
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  buffer.timestamp = behaviour.stamp.value_or(timeval{now.tv_sec, now.tv_nsec / 1000});
  return 0;
}

std::vector<std::uint8_t> FakeV4l2::State::picture_of(std::uint32_t number) const {
  const std::size_t room = image_bytes(behaviour);
  if (!behaviour.contents) return std::vector(room, static_cast<std::uint8_t>(number & 0xFF));
  std::vector<std::uint8_t> picture = behaviour.contents(number);
  LCDM_CHECK(picture.size() <= room);
  return picture;
}

bool event_is_pending() {
  if (g_state == nullptr) return false;
  const std::lock_guard lock(g_state->mutex);
  return g_state->event_pending;
}

}  // namespace lcdm::test

// umockdev knows no events: the test program is linked so that its poll() comes here (--wrap=poll).
extern "C" int __real_poll(pollfd* descriptors, nfds_t count, int timeout);
extern "C" int __wrap_poll(pollfd* descriptors, nfds_t count, int timeout) {
  const bool asked = count == 1 && (descriptors[0].events & POLLPRI) != 0;
  if (!asked || !lcdm::test::event_is_pending()) return __real_poll(descriptors, count, timeout);
  descriptors[0].revents = POLLPRI;
  return 1;
}
