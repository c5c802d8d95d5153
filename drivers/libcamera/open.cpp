// The opening half of a session: camera, format, buffers, controls, and their end.
#include <algorithm>
#include <cerrno>
#include <cmath>
#include <sys/mman.h>

#include "drivers/libcamera/session.h"

namespace lcdm {
namespace {

constexpr unsigned kLeastBuffers = 4;

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

bool has_control(const libcamera::Camera& camera, unsigned id) {
  return camera.controls().find(id) != camera.controls().end();
}

}  // namespace

// The one manager that a process may have; it ends with its last user.
std::shared_ptr<libcamera::CameraManager> shared_libcamera_manager() {
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

Status LibcameraSession::configure(const CaptureRequest& request) {
  close();
  Status status = open(request);
  if (!status) close();
  return status;
}

Status LibcameraSession::open(const CaptureRequest& request) {
  if (!manager_) manager_ = shared_libcamera_manager();
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
  stamp_ = StampSource::kStartOfExposure;
  camera_->requestCompleted.connect(this, &LibcameraSession::on_complete);
  camera_->disconnected.connect(this, &LibcameraSession::on_disconnect);
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
Status LibcameraSession::choose_format(const CaptureRequest& request) {
  configuration_ = camera_->generateConfiguration({libcamera::StreamRole::VideoRecording});
  if (!configuration_ || configuration_->empty()) {
    return Status::error(StatusCode::kUnsupported, "libcamera:%s: it has no video stream",
                         id_.c_str());
  }
  libcamera::StreamConfiguration& stream = configuration_->at(0);
  const auto listed = stream.formats().pixelformats();
  for (const KnownFormat& known : known_formats()) {
    if (request.format.value_or(known.pixel) != known.pixel) continue;
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
  return Status::error(StatusCode::kUnsupported, "libcamera:%s: gives %s", id_.c_str(),
                       request.format ? "no picture in that format: leave camera.format empty"
                                      : "none of NV12, NV21, YUYV, UYVY, RGB, MJPEG and R8");
}

Status LibcameraSession::map_buffers() {
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

// A second plane must begin where the rows of the first end: that is where it is read.
std::optional<PictureMemory> picture_memory(std::span<const libcamera::FrameBuffer::Plane> planes,
                                            const FrameFormat& format) {
  const auto rows_bytes =
      static_cast<std::size_t>(format.stride) * static_cast<std::size_t>(format.height);
  const bool two_planes = format.pixel == PixelFormat::kNv12 || format.pixel == PixelFormat::kNv21;
  if (planes.empty() || planes.size() > (two_planes ? 2U : 1U)) return std::nullopt;
  PictureMemory memory;
  for (std::size_t i = 0; i < planes.size(); ++i) {
    const bool known = planes[i].offset != libcamera::FrameBuffer::Plane::kInvalidOffset;
    const std::size_t follows = i == 0 ? 0 : memory.offset + memory.length;
    const std::size_t begin = known ? planes[i].offset : follows;
    if (i == 0) memory.offset = begin;
    if (planes[i].fd.get() != planes[0].fd.get()) return std::nullopt;
    if (i > 0 && begin != memory.offset + rows_bytes) return std::nullopt;
    memory.length = begin + planes[i].length - memory.offset;
  }
  if (memory.length == 0) return std::nullopt;
  return memory;
}

Status LibcameraSession::map_slot(Slot& slot) const {
  const auto& planes = slot.buffer->planes();
  const std::optional<PictureMemory> picture = picture_memory(planes, format);
  if (!picture) {
    return Status::error(StatusCode::kUnsupported,
                         "libcamera:%s: keeps the %zu planes of a %s picture apart: set [camera] "
                         "width and height to another size",
                         id_.c_str(), planes.size(), to_string(format.pixel));
  }
  slot.offset = picture->offset;
  slot.length = picture->length;
  void* memory =
      mmap(nullptr, slot.offset + slot.length, PROT_READ, MAP_SHARED, planes[0].fd.get(), 0);
  if (memory == MAP_FAILED) return failure(-errno, "cannot map a buffer");
  slot.memory = memory;
  return Status::ok();
}

// Pipeline handlers that know no bound leave it zero, or of no type.
std::int64_t period_within(const libcamera::ControlInfo& durations, std::int64_t wanted_us) {
  const auto bound = [wanted_us](const libcamera::ControlValue& value) {
    if (value.type() != libcamera::ControlTypeInteger64 || value.isArray()) return wanted_us;
    const auto duration_us = value.get<std::int64_t>();
    return duration_us > 0 ? duration_us : wanted_us;
  };
  return std::max(std::min(wanted_us, bound(durations.max())), bound(durations.min()));
}

void LibcameraSession::set_controls(const CaptureRequest& request) {
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
  const auto durations = camera_->controls().find(controls::FrameDurationLimits.id());
  if (durations != camera_->controls().end()) {
    const std::int64_t period_us =
        period_within(durations->second, std::lround(1e6F / request.frames_per_second));
    const std::array<std::int64_t, 2> period = {period_us, period_us};
    controls_.set(controls::FrameDurationLimits, libcamera::Span<const std::int64_t, 2>(period));
    frames_per_second_ = 1e6F / static_cast<float>(period_us);
  }
  // What is set is fixed; the algorithm goes on with the other one.
  const bool both_fixed = wanted.exposure_ms > 0 && wanted.gain >= 0;
  set(controls::AeEnable, !both_fixed, nullptr);
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

void LibcameraSession::close() {
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

Status LibcameraSession::failure(int result, const char* what) const {
  if (result == -ENODEV) {
    return Status::error(StatusCode::kDeviceGone, "libcamera:%s: the camera is gone", id_.c_str());
  }
  return Status::system(-result, "libcamera:%s: %s", id_.c_str(), what);
}

}  // namespace lcdm
