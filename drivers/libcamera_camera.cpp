// How frames come: our thread queues requests; libcamera's thread fills their buffers and calls
// on_complete, which puts the buffer's index into a ring; dequeue takes it out there.
#include "drivers/libcamera_camera.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <condition_variable>
#include <cstdio>
#include <libcamera/libcamera.h>
#include <mutex>
#include <sys/mman.h>
#include <time.h>
#include <utility>

#include "firmware/base/os.h"
#include "firmware/buffer/sequence_counter.h"

namespace lcdm {
namespace {

constexpr unsigned kLeastBuffers = 4;
constexpr std::size_t kMostBuffers = 32;

struct KnownFormat {
  libcamera::PixelFormat format;
  PixelFormat pixel;
};
// The cheapest first: colour without decoding, by bytes; then what must be decoded; then grey.
// libcamera names bytes from the last in memory to the first: its BGR888 is R, G, B.
const std::array<KnownFormat, 8>& known_formats() {
  static const std::array<KnownFormat, 8> kFormats = {{
      {libcamera::formats::NV12, PixelFormat::kNv12},
      {libcamera::formats::NV21, PixelFormat::kNv21},
      {libcamera::formats::YUYV, PixelFormat::kYuyv},
      {libcamera::formats::UYVY, PixelFormat::kUyvy},
      {libcamera::formats::BGR888, PixelFormat::kRgb24},
      {libcamera::formats::RGB888, PixelFormat::kBgr24},
      {libcamera::formats::MJPEG, PixelFormat::kMjpeg},
      {libcamera::formats::R8, PixelFormat::kGrey},
  }};
  return kFormats;
}

// The one manager that a process may have; it ends with its last user.
std::shared_ptr<libcamera::CameraManager> shared_manager() {
  static std::mutex mutex;
  static std::weak_ptr<libcamera::CameraManager> kept;
  const std::lock_guard lock(mutex);
  auto manager = kept.lock();
  if (manager) return manager;
  manager = {new libcamera::CameraManager, [](libcamera::CameraManager* ended) {
               ended->stop();
               delete ended;
             }};
  if (manager->start() != 0) return nullptr;
  kept = manager;
  return manager;
}

// libcamera stamps on CLOCK_BOOTTIME, which goes on while the machine sleeps.
std::int64_t monotonic_from_boottime(std::int64_t boottime_ns) {
  timespec now{};
  clock_gettime(CLOCK_BOOTTIME, &now);
  const std::int64_t boottime_now =
      static_cast<std::int64_t>(now.tv_sec) * 1'000'000'000 + now.tv_nsec;
  return boottime_ns - (boottime_now - os::monotonic_ns());
}

bool has_control(const libcamera::Camera& camera, unsigned id) {
  return camera.controls().find(id) != camera.controls().end();
}

}  // namespace

std::vector<std::string> list_libcamera_cameras() {
  std::vector<std::string> ids;
  if (const auto manager = shared_manager()) {
    for (const auto& camera : manager->cameras()) ids.push_back(camera->id());
  }
  return ids;
}

class LibcameraCamera::Session {
 public:
  explicit Session(std::string id) : id_(std::move(id)) {}
  ~Session() { close(); }
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;

  Status configure(const CaptureRequest& request);
  Status start();
  Result<CapturedFrame> dequeue(std::chrono::milliseconds timeout);
  Status requeue(int index);
  void stop();
  CameraInfo info() const;

  FrameFormat format;
  CameraModel model;
  int buffer_count() const { return static_cast<int>(slots_.size()); }

 private:
  struct Slot {
    std::unique_ptr<libcamera::Request> request;
    const libcamera::FrameBuffer* buffer = nullptr;
    void* memory = nullptr;
    std::size_t length = 0;
    std::size_t offset = 0;  // of the picture in it
  };
  // What libcamera's thread says about a request that ended.
  struct Completed {
    int index = -1;
    bool whole = false;
    std::uint32_t count = 0;
    std::int64_t stamp_ns = 0;  // CLOCK_MONOTONIC
    std::size_t bytes = 0;
  };

  Status open(const CaptureRequest& request);
  Status choose_format(const CaptureRequest& request);
  Status map_buffers();
  Status map_slot(Slot& slot) const;
  void set_controls(const CaptureRequest& request);
  void close();
  void on_complete(libcamera::Request* request);
  void on_disconnect();
  Status failure(int result, const char* what) const;

  const std::string id_;
  std::shared_ptr<libcamera::CameraManager> manager_;
  std::shared_ptr<libcamera::Camera> camera_;
  std::unique_ptr<libcamera::CameraConfiguration> configuration_;
  std::unique_ptr<libcamera::FrameBufferAllocator> allocator_;
  std::vector<Slot> slots_;
  libcamera::ControlList controls_{libcamera::controls::controls};
  std::string refused_;          // controls that the camera does not have
  float frames_per_second_ = 0;  // 0: it does not say
  SequenceCounter sequence_;
  bool running_ = false;

  std::mutex mutex_;  // guards what follows, which libcamera's thread writes
  std::condition_variable filled_;
  std::array<Completed, kMostBuffers> ring_{};
  std::size_t ring_begin_ = 0;
  std::size_t ring_size_ = 0;
  bool gone_ = false;
};

Status LibcameraCamera::Session::configure(const CaptureRequest& request) {
  close();
  Status status = open(request);
  if (!status) close();
  return status;
}

Status LibcameraCamera::Session::open(const CaptureRequest& request) {
  if (!manager_) manager_ = shared_manager();
  if (!manager_) {
    return Status::error(StatusCode::kIoError,
                         "libcamera:%s: libcamera does not start: may this "
                         "user open /dev/media* (group video)?",
                         id_.c_str());
  }
  camera_ = manager_->get(id_);
  if (!camera_) {
    return Status::error(StatusCode::kNotFound,
                         "libcamera:%s: no such camera: `lcdm probe` lists those that are there",
                         id_.c_str());
  }
  if (const int result = camera_->acquire(); result != 0) {
    camera_.reset();
    return failure(result, "another program holds the camera");
  }
  gone_ = false;
  camera_->requestCompleted.connect(this, &Session::on_complete);
  camera_->disconnected.connect(this, &Session::on_disconnect);
  LCDM_RETURN_IF_ERROR(choose_format(request));
  if (const int result = camera_->configure(configuration_.get()); result != 0) {
    return failure(result, "cannot set the format");
  }
  LCDM_RETURN_IF_ERROR(map_buffers());
  set_controls(request);
  model =
      CameraModel::from_field_of_view(format.width, format.height, request.assumed_field_of_view);
  return Status::ok();
}

// The cheapest format that is listed, at the size that validation makes of the request.
Status LibcameraCamera::Session::choose_format(const CaptureRequest& request) {
  configuration_ = camera_->generateConfiguration({libcamera::StreamRole::VideoRecording});
  if (!configuration_ || configuration_->empty()) {
    return Status::error(StatusCode::kUnsupported, "libcamera:%s: it has no video stream",
                         id_.c_str());
  }
  libcamera::StreamConfiguration& stream = configuration_->at(0);
  const auto listed = stream.formats().pixelformats();
  for (const KnownFormat& known : known_formats()) {
    if (!listed.empty() && std::find(listed.begin(), listed.end(), known.format) == listed.end()) {
      continue;
    }
    stream.pixelFormat = known.format;
    stream.size = {static_cast<unsigned>(request.width), static_cast<unsigned>(request.height)};
    stream.bufferCount = kLeastBuffers;
    const bool valid = configuration_->validate() != libcamera::CameraConfiguration::Invalid;
    if (!valid || stream.pixelFormat != known.format || stream.bufferCount > kMostBuffers) continue;
    const bool compressed = known.pixel == PixelFormat::kMjpeg;
    format = {known.pixel, static_cast<int>(stream.size.width),
              static_cast<int>(stream.size.height),
              compressed ? 0 : static_cast<int>(stream.stride)};
    if (compressed || is_picture(format)) return Status::ok();
  }
  return Status::error(StatusCode::kUnsupported,
                       "libcamera:%s: gives none of NV12, NV21, YUYV, UYVY, RGB, MJPEG and R8",
                       id_.c_str());
}

Status LibcameraCamera::Session::map_buffers() {
  libcamera::Stream* stream = configuration_->at(0).stream();
  allocator_ = std::make_unique<libcamera::FrameBufferAllocator>(camera_);
  if (const int result = allocator_->allocate(stream); result < 0) {
    return failure(result, "cannot allocate buffers");
  }
  const auto& buffers = allocator_->buffers(stream);
  if (buffers.size() < 2 || buffers.size() > kMostBuffers) {
    return Status::error(StatusCode::kUnsupported, "libcamera:%s: it gives %zu buffers",
                         id_.c_str(), buffers.size());
  }
  for (const auto& buffer : buffers) {
    Slot& slot = slots_.emplace_back();
    slot.buffer = buffer.get();
    LCDM_RETURN_IF_ERROR(map_slot(slot));
    slot.request = camera_->createRequest(slots_.size() - 1);
    if (!slot.request || slot.request->addBuffer(stream, buffer.get()) != 0) {
      return failure(-EIO, "cannot make a request");
    }
  }
  return Status::ok();
}

// The planes of a picture must follow each other in one piece of memory.
Status LibcameraCamera::Session::map_slot(Slot& slot) const {
  const auto& planes = slot.buffer->planes();
  std::size_t end = 0;
  for (std::size_t i = 0; i < planes.size(); ++i) {
    const bool known = planes[i].offset != libcamera::FrameBuffer::Plane::kInvalidOffset;
    const std::size_t begin = known ? planes[i].offset : end;
    if (i == 0) slot.offset = begin;
    if (planes[i].fd.get() != planes[0].fd.get() || (i > 0 && begin != end)) {
      return Status::error(StatusCode::kUnsupported,
                           "libcamera:%s: keeps the planes of a picture apart", id_.c_str());
    }
    end = begin + planes[i].length;
  }
  void* memory =
      end == 0 ? MAP_FAILED : mmap(nullptr, end, PROT_READ, MAP_SHARED, planes[0].fd.get(), 0);
  if (memory == MAP_FAILED) return failure(-errno, "cannot map a buffer");
  slot.memory = memory;
  slot.length = end - slot.offset;
  return Status::ok();
}

void LibcameraCamera::Session::set_controls(const CaptureRequest& request) {
  namespace controls = libcamera::controls;
  const ImageControls& wanted = request.controls;
  controls_.clear();
  refused_.clear();
  frames_per_second_ = 0;
  // Sets a control that the camera has; names what was asked for and it has not.
  const auto set = [this](const auto& control, const auto& value, const char* asked) {
    if (has_control(*camera_, control.id())) {
      controls_.set(control, value);
      return true;
    }
    if (asked != nullptr) refused_ += (refused_.empty() ? "" : ", ") + std::string(asked);
    return false;
  };
  const auto period_us = static_cast<std::int64_t>(std::lround(1e6F / request.frames_per_second));
  const std::array<std::int64_t, 2> period = {period_us, period_us};
  if (set(controls::FrameDurationLimits, libcamera::Span<const std::int64_t, 2>(period), nullptr)) {
    frames_per_second_ = request.frames_per_second;
  }
  const bool manual = wanted.exposure_ms > 0 || wanted.gain >= 0;
  set(controls::AeEnable, !manual, nullptr);
  if (wanted.exposure_ms > 0) {
    set(controls::ExposureTime, static_cast<std::int32_t>(std::lround(wanted.exposure_ms * 1000)),
        "exposure");
  }
  if (wanted.gain >= 0) set(controls::AnalogueGain, static_cast<float>(wanted.gain), "gain");
  set(controls::AwbEnable, true, nullptr);
  const auto refuse = [this](bool asked, const char* name) {
    if (asked) refused_ += (refused_.empty() ? "" : ", ") + std::string(name);
  };
  refuse(wanted.white_balance_kelvin > 0, "white balance");
  refuse(wanted.power_line_hz > 0, "mains frequency");
}

void LibcameraCamera::Session::close() {
  stop();
  for (Slot& slot : slots_) {
    slot.request.reset();
    if (slot.memory != nullptr) munmap(slot.memory, slot.offset + slot.length);
  }
  slots_.clear();
  allocator_.reset();
  configuration_.reset();
  if (!camera_) return;
  camera_->requestCompleted.disconnect(this);
  camera_->disconnected.disconnect(this);
  camera_->release();
  camera_.reset();
}

CameraInfo LibcameraCamera::Session::info() const {
  char text[240];
  std::snprintf(text, sizeof(text), "%.80s, %s %dx%d%s%s", id_.c_str(), to_string(format.pixel),
                format.width, format.height, refused_.empty() ? "" : "; it cannot set ",
                refused_.c_str());
  return {"libcamera:" + id_, text, frames_per_second_, StampSource::kStartOfExposure};
}

Status LibcameraCamera::Session::start() {
  if (slots_.empty()) {
    return Status::error(StatusCode::kInvalidInput, "libcamera:%s: not configured", id_.c_str());
  }
  ring_size_ = 0;
  sequence_.reset();
  if (const int result = camera_->start(&controls_); result != 0) {
    return failure(result, "cannot start streaming");
  }
  running_ = true;
  for (int i = 0; i < buffer_count(); ++i) LCDM_RETURN_IF_ERROR(requeue(i));
  return Status::ok();
}

// libcamera's stop waits until its thread has given up every request.
void LibcameraCamera::Session::stop() {
  if (!running_) return;
  camera_->stop();
  running_ = false;
  const std::lock_guard lock(mutex_);
  ring_size_ = 0;
}

Result<CapturedFrame> LibcameraCamera::Session::dequeue(std::chrono::milliseconds timeout) {
  Completed done;
  {
    std::unique_lock lock(mutex_);
    filled_.wait_for(lock, timeout, [this] { return ring_size_ > 0 || gone_; });
    if (gone_) {
      return Status::error(StatusCode::kDeviceGone, "libcamera:%s: the camera is gone",
                           id_.c_str());
    }
    if (ring_size_ == 0) {
      return Status::error(StatusCode::kTimeout, "libcamera:%s: no frame in time", id_.c_str());
    }
    done = ring_[ring_begin_];
    ring_begin_ = (ring_begin_ + 1) % ring_.size();
    --ring_size_;
  }
  const Slot& slot = slots_[static_cast<std::size_t>(done.index)];
  const std::uint64_t sequence = sequence_.next(done.count);
  const std::size_t needed = format.pixel == PixelFormat::kMjpeg ? 1 : picture_bytes(format);
  if (!done.whole || done.bytes < needed || done.bytes > slot.length) {
    LCDM_RETURN_IF_ERROR(requeue(done.index));
    return Status::error(StatusCode::kCorrupt, "libcamera:%s: damaged frame (%zu bytes)",
                         id_.c_str(), done.bytes);
  }
  CapturedFrame frame;
  frame.index = done.index;
  frame.view.format = format;
  frame.view.data = static_cast<const std::uint8_t*>(slot.memory) + slot.offset;
  frame.view.bytes = done.bytes;
  frame.view.meta.sequence = sequence;
  frame.view.meta.sensor_ns = std::min(done.stamp_ns, os::monotonic_ns());
  frame.view.meta.unix_ns = frame.view.meta.sensor_ns + os::unix_offset_ns();
  return frame;
}

Status LibcameraCamera::Session::requeue(int index) {
  if (index < 0 || index >= buffer_count()) {
    return Status::error(StatusCode::kInvalidInput, "libcamera:%s: no buffer %d", id_.c_str(),
                         index);
  }
  libcamera::Request* request = slots_[static_cast<std::size_t>(index)].request.get();
  request->reuse(libcamera::Request::ReuseBuffers);
  if (const int result = camera_->queueRequest(request); result != 0) {
    return failure(result, "cannot give a buffer back");
  }
  return Status::ok();
}

// On libcamera's thread. Whatever is not a whole frame is unusable: newer versions have more
// reasons than older ones.
void LibcameraCamera::Session::on_complete(libcamera::Request* request) {
  if (request->status() == libcamera::Request::RequestCancelled) return;
  Completed done;
  done.index = static_cast<int>(request->cookie());
  const libcamera::FrameMetadata& metadata =
      slots_[static_cast<std::size_t>(done.index)].buffer->metadata();
  done.whole = metadata.status == libcamera::FrameMetadata::FrameSuccess;
  done.count = metadata.sequence;
  const auto sensor = request->metadata().get(libcamera::controls::SensorTimestamp);
  done.stamp_ns =
      monotonic_from_boottime(sensor ? *sensor : static_cast<std::int64_t>(metadata.timestamp));
  for (const auto& plane : metadata.planes()) done.bytes += plane.bytesused;
  const std::lock_guard lock(mutex_);
  ring_[(ring_begin_ + ring_size_) % ring_.size()] = done;
  ++ring_size_;
  filled_.notify_one();
}

void LibcameraCamera::Session::on_disconnect() {
  const std::lock_guard lock(mutex_);
  gone_ = true;
  filled_.notify_one();
}

Status LibcameraCamera::Session::failure(int result, const char* what) const {
  if (result == -ENODEV) {
    return Status::error(StatusCode::kDeviceGone, "libcamera:%s: the camera is gone", id_.c_str());
  }
  return Status::system(-result, "libcamera:%s: %s", id_.c_str(), what);
}

LibcameraCamera::LibcameraCamera(std::string id)
    : session_(std::make_unique<Session>(std::move(id))) {}
LibcameraCamera::~LibcameraCamera() = default;

Status LibcameraCamera::configure(const CaptureRequest& request) {
  return session_->configure(request);
}
const FrameFormat& LibcameraCamera::format() const { return session_->format; }
CameraModel LibcameraCamera::model() const { return session_->model; }
CameraInfo LibcameraCamera::info() const { return session_->info(); }
int LibcameraCamera::buffer_count() const { return session_->buffer_count(); }
Status LibcameraCamera::start() { return session_->start(); }
Result<CapturedFrame> LibcameraCamera::dequeue(std::chrono::milliseconds timeout) {
  return session_->dequeue(timeout);
}
Status LibcameraCamera::requeue(int index) { return session_->requeue(index); }
void LibcameraCamera::stop() { session_->stop(); }

}  // namespace lcdm
