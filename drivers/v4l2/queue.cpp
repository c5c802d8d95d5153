#include "drivers/v4l2/queue.h"

#include <algorithm>
#include <cerrno>
#include <fcntl.h>
#include <optional>
#include <sys/mman.h>
#include <utility>

#include "firmware/base/os.h"

namespace lcdm {
namespace {

// Beyond what the driver needs itself: one buffer in the mailbox, one with infer, one on the way.
constexpr std::uint32_t kBuffersOutside = 3;
constexpr std::uint32_t kLeastBuffers = 4;
constexpr std::uint32_t kMostBuffers = 32;
constexpr std::uint32_t kMaxSide = 8192;
// A frame that waited longer for us cannot be: by then the watchdog has ended the process.
constexpr std::int64_t kOldestNs = 10'000'000'000;

// What S_FMT answered, of either kind of queue.
struct Answer {
  std::uint32_t fourcc = 0;
  std::uint32_t width = 0;
  std::uint32_t height = 0;
  std::uint32_t stride = 0;
  std::uint32_t planes = 1;  // of memory
};

v4l2_format wanted_format(const V4l2Device& device, const V4l2Choice& choice) {
  v4l2_format format{};
  format.type = device.queue();
  const auto width = static_cast<std::uint32_t>(choice.width);
  const auto height = static_cast<std::uint32_t>(choice.height);
  if (device.multi_planar()) {
    format.fmt.pix_mp.width = width;
    format.fmt.pix_mp.height = height;
    format.fmt.pix_mp.pixelformat = choice.fourcc;
    format.fmt.pix_mp.field = V4L2_FIELD_NONE;
    format.fmt.pix_mp.num_planes = 1;
  } else {
    format.fmt.pix.width = width;
    format.fmt.pix.height = height;
    format.fmt.pix.pixelformat = choice.fourcc;
    format.fmt.pix.field = V4L2_FIELD_NONE;
  }
  return format;
}

Answer answer_of(const V4l2Device& device, const v4l2_format& format) {
  if (device.multi_planar()) {
    const v4l2_pix_format_mplane& pix = format.fmt.pix_mp;
    return {pix.pixelformat, pix.width, pix.height, pix.plane_fmt[0].bytesperline, pix.num_planes};
  }
  const v4l2_pix_format& pix = format.fmt.pix;
  return {pix.pixelformat, pix.width, pix.height, pix.bytesperline, 1};
}

FrameFormat format_of(const Answer& answer, PixelFormat pixel) {
  return {pixel, static_cast<int>(answer.width), static_cast<int>(answer.height),
          pixel == PixelFormat::kMjpeg ? 0 : static_cast<int>(answer.stride)};
}

bool makes_sense(const Answer& answer, const V4l2Choice& choice) {
  const bool fits = answer.width > 0 && answer.width <= kMaxSide && answer.height > 0 &&
                    answer.height <= kMaxSide && answer.stride <= 8 * kMaxSide;
  if (!fits || answer.fourcc != choice.fourcc || answer.planes != 1) return false;
  return choice.pixel == PixelFormat::kMjpeg || is_picture(format_of(answer, choice.pixel));
}

StampSource stamp_source(std::uint32_t flags) {
  if ((flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) != V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC) {
    return StampSource::kArrival;
  }
  return (flags & V4L2_BUF_FLAG_TSTAMP_SRC_MASK) == V4L2_BUF_FLAG_TSTAMP_SRC_SOE
             ? StampSource::kStartOfExposure
             : StampSource::kEndOfFrame;
}

// The stamp of a frame that is taken at `now_ns`; empty where it can be none. Every number is
// possible: drivers forget to stamp, stamp on another clock, or in the future.
std::optional<std::int64_t> believable_ns(const timeval& time, std::int64_t now_ns) {
  constexpr std::int64_t kSecond = 1'000'000'000;
  const auto seconds = static_cast<std::int64_t>(time.tv_sec);
  const auto microseconds = static_cast<std::int64_t>(time.tv_usec);
  if (seconds < 0 || seconds > now_ns / kSecond) return std::nullopt;  // nor can it overflow now
  if (microseconds < 0 || microseconds >= 1'000'000) return std::nullopt;
  const std::int64_t stamp_ns = seconds * kSecond + microseconds * 1'000;
  const bool believable = stamp_ns > 0 && stamp_ns <= now_ns && now_ns - stamp_ns <= kOldestNs;
  return believable ? std::optional(stamp_ns) : std::nullopt;
}

}  // namespace

Result<FrameFormat> V4l2Queue::set_format(const V4l2Choice& choice) {
  v4l2_format format = wanted_format(device_, choice);
  if (const int fault = device_.control(VIDIOC_S_FMT, &format); fault != 0) {
    return device_.failure(fault, "cannot set a format");
  }
  const Answer answer = answer_of(device_, format);
  if (!makes_sense(answer, choice)) {
    return Status::error(StatusCode::kUnsupported,
                         "v4l2:%s: asked for %s %dx%d, its driver answers %s %ux%u, stride %u, %u "
                         "planes; set [camera] width and height to a size that `lcdm probe` lists",
                         device_.path().c_str(), to_string(choice.pixel), choice.width,
                         choice.height, fourcc_text(answer.fourcc).c_str(), answer.width,
                         answer.height, answer.stride, answer.planes);
  }
  return format_of(answer, choice.pixel);
}

float V4l2Queue::set_rate(float frames_per_second) const {
  v4l2_streamparm parameters{};
  parameters.type = device_.queue();
  parameters.parm.capture.timeperframe = {1000,
                                          static_cast<std::uint32_t>(frames_per_second * 1000)};
  if (device_.control(VIDIOC_S_PARM, &parameters) != 0 &&
      device_.control(VIDIOC_G_PARM, &parameters) != 0) {
    return 0;
  }
  const v4l2_fract& period = parameters.parm.capture.timeperframe;
  if (period.numerator == 0) return 0;
  return static_cast<float>(period.denominator) / static_cast<float>(period.numerator);
}

Status V4l2Queue::map() {
  v4l2_control least{V4L2_CID_MIN_BUFFERS_FOR_CAPTURE, 1};
  if (device_.control(VIDIOC_G_CTRL, &least) != 0) least.value = 1;
  v4l2_requestbuffers request{};
  request.type = device_.queue();
  request.memory = V4L2_MEMORY_MMAP;
  request.count = std::max(
      kLeastBuffers, static_cast<std::uint32_t>(std::clamp(least.value, 1, 16)) + kBuffersOutside);
  if (const int fault = device_.control(VIDIOC_REQBUFS, &request); fault != 0) {
    return device_.failure(fault, "cannot reserve buffers");
  }
  // The driver may give fewer. Two is the least with which it can fill one while we hold one.
  if (request.count < 2 || request.count > kMostBuffers) {
    return Status::error(StatusCode::kUnsupported, "v4l2:%s: the driver gives %u buffers",
                         device_.path().c_str(), request.count);
  }
  for (std::uint32_t i = 0; i < request.count; ++i) LCDM_RETURN_IF_ERROR(map_one(i));
  return Status::ok();
}

Status V4l2Queue::map_one(std::uint32_t index) {
  Slot slot;
  prepare(slot, index);
  if (const int fault = device_.control(VIDIOC_QUERYBUF, &slot.buffer); fault != 0) {
    return device_.failure(fault, "cannot ask for a buffer");
  }
  const bool planes = device_.multi_planar();
  const std::size_t length = planes ? slot.plane.length : slot.buffer.length;
  const std::uint32_t offset = planes ? slot.plane.m.mem_offset : slot.buffer.m.offset;
  void* memory = mmap(nullptr, length, PROT_READ | PROT_WRITE, MAP_SHARED, device_.fd(),
                      static_cast<off_t>(offset));
  if (memory == MAP_FAILED) return device_.failure(errno, "cannot map a buffer");
  buffers_.push_back({memory, length, false});
  stamp_ = stamp_source(slot.buffer.flags);
  return Status::ok();
}

Result<int> V4l2Queue::export_buffer(int index) const {
  if (index < 0 || index >= size()) {
    return Status::error(StatusCode::kInvalidInput, "v4l2:%s: no buffer %d", device_.path().c_str(),
                         index);
  }
  v4l2_exportbuffer request{};
  request.type = device_.queue();
  request.index = static_cast<std::uint32_t>(index);
  request.flags = O_RDONLY | O_CLOEXEC;
  const int fault = device_.control(VIDIOC_EXPBUF, &request);
  if (fault == 0) return request.fd;
  if (fault == ENODEV) return device_.failure(fault, "cannot share a buffer");
  return Status::error(StatusCode::kUnsupported, "v4l2:%s: the driver cannot share its buffers",
                       device_.path().c_str());
}

void V4l2Queue::unmap() {
  stop();
  for (const Mapping& mapping : buffers_) munmap(mapping.memory, mapping.length);
  buffers_.clear();
}

Status V4l2Queue::start() {
  for (int i = 0; i < size(); ++i) LCDM_RETURN_IF_ERROR(enqueue(i));
  std::uint32_t type = device_.queue();
  if (const int fault = device_.control(VIDIOC_STREAMON, &type); fault != 0) {
    return device_.failure(fault, "cannot start streaming");
  }
  return Status::ok();
}

void V4l2Queue::stop() {
  if (buffers_.empty()) return;
  std::uint32_t type = device_.queue();
  device_.control(VIDIOC_STREAMOFF, &type);  // a gone device may refuse
}

Status V4l2Queue::enqueue(int index) {
  if (index < 0 || index >= size()) {
    return Status::error(StatusCode::kInvalidInput, "v4l2:%s: no buffer %d", device_.path().c_str(),
                         index);
  }
  Slot slot;
  prepare(slot, static_cast<std::uint32_t>(index));
  if (const int fault = device_.control(VIDIOC_QBUF, &slot.buffer); fault != 0) {
    return device_.failure(fault, "cannot give a buffer back");
  }
  buffers_[static_cast<std::size_t>(index)].with_driver = true;
  return Status::ok();
}

int V4l2Queue::dequeue(V4l2Filled& filled) {
  Slot slot;
  prepare(slot, 0);
  if (const int fault = device_.control(VIDIOC_DQBUF, &slot.buffer); fault != 0) return fault;
  if (slot.buffer.index >= buffers_.size()) return EBADMSG;
  Mapping& mapping = buffers_[slot.buffer.index];
  const bool planes = device_.multi_planar();
  const std::size_t begin = planes ? slot.plane.data_offset : 0;
  const std::size_t end = planes ? slot.plane.bytesused : slot.buffer.bytesused;
  const bool inside = begin <= end && end <= mapping.length;
  filled.index = static_cast<int>(slot.buffer.index);
  filled.ours = !std::exchange(mapping.with_driver, false);
  filled.data = static_cast<const std::uint8_t*>(mapping.memory) + (inside ? begin : 0);
  filled.bytes = inside ? end - begin : 0;
  filled.flags = slot.buffer.flags;
  filled.sequence = slot.buffer.sequence;
  filled.stamp_ns = stamp_of(slot.buffer);
  return 0;
}

// The driver's stamp, or the time of arrival. A driver that was wrong once is not asked again: the
// stamps of one stream mean one thing.
std::int64_t V4l2Queue::stamp_of(const v4l2_buffer& buffer) {
  const std::int64_t now_ns = os::monotonic_ns();
  if (stamp_ == StampSource::kArrival) return now_ns;
  const std::optional<std::int64_t> stamp_ns = believable_ns(buffer.timestamp, now_ns);
  if (!stamp_ns) stamp_ = StampSource::kArrival;
  return stamp_ns.value_or(now_ns);
}

// An empty slot for this queue. It must not move afterwards: the buffer points to the plane.
void V4l2Queue::prepare(Slot& slot, std::uint32_t index) const {
  slot.buffer.type = device_.queue();
  slot.buffer.memory = V4L2_MEMORY_MMAP;
  slot.buffer.index = index;
  if (!device_.multi_planar()) return;
  slot.buffer.m.planes = &slot.plane;
  slot.buffer.length = 1;
}

}  // namespace lcdm
