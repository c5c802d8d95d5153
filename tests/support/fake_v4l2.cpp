#include "tests/support/fake_v4l2.h"

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <deque>
#include <fcntl.h>
#include <mutex>
#include <string>
#include <umockdev.h>
#include <unistd.h>
#include <vector>

#include "firmware/base/check.h"

namespace lcdm::test {
namespace {

constexpr std::uint32_t kPage = 4096;

std::uint32_t stride_of(const FakeV4l2::Behaviour& behaviour) {
  const std::uint32_t packed = behaviour.fourcc == V4L2_PIX_FMT_YUYV ? behaviour.width * 2 : 0;
  return packed + behaviour.row_padding;
}

std::uint32_t image_bytes(const FakeV4l2::Behaviour& behaviour) {
  const std::uint32_t stride = stride_of(behaviour);
  return stride == 0 ? behaviour.width * behaviour.height : stride * behaviour.height;
}

std::uint32_t buffer_stride(const FakeV4l2::Behaviour& behaviour) {
  return (image_bytes(behaviour) + kPage - 1) / kPage * kPage;
}

}  // namespace

// Shared between the test's thread and umockdev's, which answers the ioctls.
struct FakeV4l2::State {
  mutable std::mutex mutex;
  Behaviour behaviour;
  std::deque<std::uint32_t> queued;
  std::uint32_t granted = 0;
  std::uint32_t sequence = 0;
  int requests = 0;
  int backing = -1;
  UMockdevTestbed* testbed = nullptr;
  UMockdevIoctlBase* handler = nullptr;

  int handle(unsigned request, void* argument);
  int dequeue(v4l2_buffer& buffer);
};

namespace {

// GObject carries no C++ pointer: one fake per process at a time, as there is one /dev/video0.
FakeV4l2::State* g_state = nullptr;

std::size_t argument_size(unsigned long request) { return (request >> 16) & 0x3FFF; }

gboolean on_ioctl(UMockdevIoctlBase* /*base*/, UMockdevIoctlClient* client) {
  const gulong request = umockdev_ioctl_client_get_request(client);
  UMockdevIoctlData* pointer = umockdev_ioctl_client_get_arg(client);
  UMockdevIoctlData* data =
      umockdev_ioctl_data_resolve(pointer, 0, argument_size(request), nullptr);
  const int fault =
      data == nullptr ? EFAULT : g_state->handle(static_cast<unsigned>(request), data->data);
  if (data != nullptr) umockdev_ioctl_data_unref(data);
  umockdev_ioctl_client_complete(client, fault == 0 ? 0 : -1, fault);
  return TRUE;
}

std::string node_description() {
  // Contents (N: with bytes) make the node a file, so that mmap on it works.
  return "P: /devices/fake/video4linux/video0\nN: video0=" + std::string(32, '0') +
         "\nE: SUBSYSTEM=video4linux\nE: DEVNAME=/dev/video0\nE: MAJOR=81\nE: MINOR=0\n"
         "A: name=fake\n\n";
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
  LCDM_CHECK(umockdev_testbed_add_from_string(state_->testbed, node_description().c_str(), &error));
  char* root = umockdev_testbed_get_root_dir(state_->testbed);
  const std::string file = std::string(root) + kPath;
  g_free(root);
  state_->backing = open(file.c_str(), O_RDWR | O_CLOEXEC);
  LCDM_CHECK(state_->backing >= 0);

  state_->handler = UMOCKDEV_IOCTL_BASE(g_object_new(umockdev_ioctl_base_get_type(), nullptr));
  g_signal_connect(state_->handler, "handle-ioctl", G_CALLBACK(on_ioctl), nullptr);
  LCDM_CHECK(umockdev_testbed_attach_ioctl(state_->testbed, kPath, state_->handler, &error));
}

FakeV4l2::~FakeV4l2() {
  umockdev_testbed_detach_ioctl(state_->testbed, kPath, nullptr);
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

int FakeV4l2::State::handle(unsigned request, void* argument) {
  const std::lock_guard lock(mutex);
  switch (request) {
    case VIDIOC_QUERYCAP: {
      auto& capability = *static_cast<v4l2_capability*>(argument);
      capability = {};
      std::strcpy(reinterpret_cast<char*>(capability.card), "fake camera");
      capability.capabilities = behaviour.capabilities | V4L2_CAP_DEVICE_CAPS;
      capability.device_caps = behaviour.capabilities;
      return 0;
    }
    case VIDIOC_ENUM_FMT: {
      auto& format = *static_cast<v4l2_fmtdesc*>(argument);
      if (format.index != 0) return EINVAL;
      format.pixelformat = behaviour.fourcc;
      return 0;
    }
    case VIDIOC_S_FMT: {
      auto& pix = static_cast<v4l2_format*>(argument)->fmt.pix;
      pix.pixelformat = behaviour.fourcc;
      pix.width = behaviour.width;
      pix.height = behaviour.height;
      pix.bytesperline = stride_of(behaviour);
      pix.sizeimage = image_bytes(behaviour);
      return 0;
    }
    case VIDIOC_S_PARM: {
      auto& period = static_cast<v4l2_streamparm*>(argument)->parm.capture.timeperframe;
      period = {1, 25};
      return 0;
    }
    case VIDIOC_REQBUFS: {
      auto& buffers = *static_cast<v4l2_requestbuffers*>(argument);
      granted = buffers.count = std::min(buffers.count, behaviour.most_buffers);
      queued.clear();
      return ftruncate(backing, static_cast<off_t>(granted) * buffer_stride(behaviour)) == 0 ? 0
                                                                                             : EIO;
    }
    case VIDIOC_QUERYBUF: {
      auto& buffer = *static_cast<v4l2_buffer*>(argument);
      buffer.length = image_bytes(behaviour);
      buffer.m.offset = buffer.index * buffer_stride(behaviour);
      return 0;
    }
    case VIDIOC_QBUF: {
      const std::uint32_t index = static_cast<v4l2_buffer*>(argument)->index;
      if (index >= granted) return EINVAL;
      queued.push_back(index);
      return 0;
    }
    case VIDIOC_DQBUF:
      return dequeue(*static_cast<v4l2_buffer*>(argument));
    case VIDIOC_STREAMON:
      return 0;
    case VIDIOC_STREAMOFF:
      queued.clear();
      return 0;
    default:
      return ENOTTY;
  }
}

int FakeV4l2::State::dequeue(v4l2_buffer& buffer) {
  const Answer answer = behaviour.answer(requests++);
  if (answer == Answer::kIoError) return EIO;
  if (answer == Answer::kGone) return ENODEV;
  if (answer == Answer::kNothing || queued.empty()) return EAGAIN;

  buffer.index = queued.front();
  queued.pop_front();
  const std::vector<char> picture(image_bytes(behaviour), static_cast<char>(sequence & 0xFF));
  const auto offset = static_cast<off_t>(buffer.index) * buffer_stride(behaviour);
  if (pwrite(backing, picture.data(), picture.size(), offset) < 0) return EIO;
  buffer.bytesused = image_bytes(behaviour);
  if (answer == Answer::kShortFrame) buffer.bytesused = 0;
  if (answer == Answer::kHugeFrame) buffer.bytesused = 0x7FFFFFFF;
  if (answer == Answer::kWildIndex) buffer.index = 1000;
  buffer.flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
  if (answer == Answer::kErrorFlag) buffer.flags |= V4L2_BUF_FLAG_ERROR;
  buffer.sequence = sequence++;
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  buffer.timestamp = {now.tv_sec, now.tv_nsec / 1000};
  return 0;
}

}  // namespace lcdm::test
