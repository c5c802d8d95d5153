#include "app/recorder.h"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <ctime>
#include <fcntl.h>
#include <filesystem>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <system_error>
#include <unistd.h>

#include "firmware/base/os.h"
#include "firmware/wire/foxglove.h"

namespace lcdm {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kChunkNs = 1'000'000'000;  // what a power cut may cost
constexpr std::size_t kChunkBytes = 8U << 20;
constexpr std::size_t kChunkMessages = 256;
constexpr std::size_t kChunks = 4096;  // of a segment: over an hour
constexpr std::size_t kMessageHead = 256;
constexpr std::size_t kCalibrationBytes = 2048;  // its message, with room to spare
constexpr std::uint16_t kImageChannel = 1;
constexpr std::uint16_t kCalibrationChannel = 2;

std::size_t frame_capacity(const FrameFormat& format) {
  if (format.pixel == PixelFormat::kMjpeg) return jpeg_capacity(format);
  return picture_bytes(format) + static_cast<std::size_t>(format.stride);  // with all its padding
}

// lcdm-20261121T113005.250Z.mcap: sorts by time, safe on every file system.
std::string segment_name(std::int64_t unix_ns) {
  const std::time_t seconds = unix_ns / 1'000'000'000;
  std::tm utc{};
  gmtime_r(&seconds, &utc);
  char text[32];
  std::strftime(text, sizeof(text), "%Y%m%dT%H%M%S", &utc);
  char name[64];
  std::snprintf(name, sizeof(name), "lcdm-%s.%03dZ.mcap", text,
                static_cast<int>(unix_ns / 1'000'000 % 1000));
  return name;
}

std::array<wire::McapChannel, 2> recorded_channels() {
  using namespace wire;  // NOLINT(google-build-using-namespace): five names of it
  return {{{"/camera/image/compressed", kCompressedImageSchema,
            foxglove_descriptor(kCompressedImageSchema)},
           {"/camera/calibration", kCameraCalibrationSchema,
            foxglove_descriptor(kCameraCalibrationSchema)}}};
}

}  // namespace

Recorder::Recorder(RecorderOptions options) : options_(std::move(options)) {}

Recorder::~Recorder() { stop(); }

Status Recorder::start(const std::string& source, const FrameFormat& format,
                       const CameraModel& camera) {
  const std::lock_guard control(control_mutex_);
  if (status().recording) return Status::ok();
  end();
  std::error_code error;
  fs::create_directories(options_.directory, error);
  if (error) {
    return Status::system(error.value(),
                          "recording: cannot make the folder %s (set [record] "
                          "directory to one this user may write)",
                          options_.directory.c_str());
  }
  source_ = source;
  camera_ = camera;
  Status status = prepare_slots(format);
  if (status) {
    // A chunk holds at least a calibration and the largest picture.
    writer_.emplace(std::max(kChunkBytes, message_.size() + kCalibrationBytes), kChunkMessages,
                    kChunks);
    status = open_segment();
  }
  if (!status) {
    writer_.reset();
    return status;
  }
  {
    const std::lock_guard lock(mutex_);
    fault_.clear();
    under_way_ = true;
  }
  frames_ = dropped_ = bytes_ = 0;
  stopping_ = false;
  try {
    thread_ = std::thread([this] { record_loop(); });
  } catch (const std::system_error& refused) {
    file_.remove();
    writer_.reset();
    const std::lock_guard lock(mutex_);
    under_way_ = false;
    return Status::system(refused.code().value(), "recording: no thread for it");
  }
  taking_ = true;
  return Status::ok();
}

void Recorder::stop() {
  const std::lock_guard control(control_mutex_);
  end();
}

void Recorder::end() {
  taking_ = false;
  stopping_ = true;
  work_.release();
  if (thread_.joinable()) thread_.join();
  writer_.reset();
}

RecorderStatus Recorder::status() const {
  const std::lock_guard lock(mutex_);
  return {under_way_, frames_, dropped_, bytes_, path_, fault_};
}

bool Recorder::push(const FrameView& frame) noexcept {
  const std::unique_lock lock(push_mutex_, std::try_to_lock);
  if (!lock || !taking_) return false;
  if (frame.format != format_) {
    if (++foreign_ >= kForeignFrames && !format_changed_.exchange(true)) work_.release();
    return false;
  }
  foreign_ = 0;
  // A driver's padding behind the picture is left out; a JPEG's bytes all belong to it.
  const bool padded = frame.bytes > frame_capacity_ && format_.pixel != PixelFormat::kMjpeg;
  const std::size_t bytes = padded ? frame_capacity_ : frame.bytes;
  if (bytes > frame_capacity_) return false;
  const auto index = free_.pop();
  if (!index) return false;
  Slot& slot = slots_[*index];
  std::memcpy(slot.pixels.data(), frame.data, bytes);
  slot.view = frame;
  slot.view.bytes = bytes;
  slot.view.data = slot.pixels.data();
  const bool queued = filled_.push(*index);
  LCDM_CHECK(queued);  // as many entries as slots
  work_.release();
  return true;
}

void Recorder::push_or_drop(const FrameView& frame) noexcept {
  if (taking_ && !push(frame)) dropped_.fetch_add(1, std::memory_order_relaxed);
}

void Recorder::offer(const DepthFrame& frame) noexcept { push_or_drop(frame.colour); }

// Every buffer of a recording is taken here.
Status Recorder::prepare_slots(const FrameFormat& format) {
  const std::lock_guard lock(push_mutex_);
  format_ = format;
  frame_capacity_ = frame_capacity(format);
  foreign_ = 0;
  format_changed_ = false;
  while (filled_.pop()) continue;
  while (free_.pop()) continue;
  while (work_.try_acquire()) continue;
  for (std::size_t i = 0; i < kSlots; ++i) {
    slots_[i].pixels.assign(frame_capacity_, 0);
    LCDM_CHECK(free_.push(i));
  }
  jpeg_.resize(jpeg_capacity(format));
  message_.resize(jpeg_.size() + kMessageHead);
  if (format.pixel == PixelFormat::kMjpeg) return Status::ok();
  return encoder_.prepare(format, kKeptQuality);
}

Status Recorder::open_segment() {
  // A segment filled within a millisecond, or a clock that was set back, meets a name that is
  // taken: the next free one then.
  constexpr int kTries = 1000;
  constexpr std::int64_t kMillisecond = 1'000'000;
  const std::int64_t now = os::monotonic_ns() + os::unix_offset_ns();
  std::string path;
  Status opened;
  for (int i = 0; i < kTries; ++i) {
    path = (fs::path(options_.directory) / segment_name(now + i * kMillisecond)).string();
    opened = file_.open(path, options_.keep_free_bytes);
    if (opened.sys_errno() != EEXIST) break;
  }
  if (!opened) {
    file_.remove();
    return opened;
  }
  channels_ = recorded_channels();
  const std::string_view metadata[] = {"version", "1",        "source",
                                       source_,   "frame_id", wire::kOpticalFrame};
  const Status status = writer_->begin(file_, channels_, metadata);
  if (!status) {
    file_.remove();
    return status;
  }
  chunk_begin_ns_ = 0;
  const std::lock_guard lock(mutex_);
  path_ = path;
  return Status::ok();
}

void Recorder::record_loop() {
  os::set_thread_name("record");
  os::lower_thread_priority(5);
  Status status;
  Status room;
  while (status && room) {
    heartbeat_.rest();
    work_.acquire();
    heartbeat_.beat(os::monotonic_ns());
    const auto index = filled_.pop();
    if (!index) {
      if (stopping_ || format_changed_) break;
      continue;
    }
    status = write(slots_[*index].view);
    room = file_.check_room();
    LCDM_CHECK(free_.push(*index));
  }
  finish(status, room);
  heartbeat_.rest();
}

Status Recorder::write(const FrameView& frame) {
  const std::int64_t now = frame.meta.unix_ns;
  if (writer_->file_bytes() > static_cast<std::uint64_t>(options_.segment_bytes) ||
      !writer_->has_room_for_chunk()) {
    LCDM_RETURN_IF_ERROR(writer_->finish());
    LCDM_RETURN_IF_ERROR(open_segment());
  }
  const bool clock_went_back = now < chunk_begin_ns_;
  if (chunk_begin_ns_ == 0 || clock_went_back || now - chunk_begin_ns_ >= kChunkNs) {
    LCDM_RETURN_IF_ERROR(begin_chunk(frame.meta));
  }
  const auto jpeg = as_jpeg(frame);
  if (!jpeg) {
    dropped_.fetch_add(1, std::memory_order_relaxed);  // one broken picture is no broken disk
    return Status::ok();
  }
  wire::ByteWriter out(message_);
  wire::encode(wire::CompressedImage{now, "jpeg", *jpeg}, out);
  LCDM_CHECK(out.ok());
  const auto write_message = [&] {
    return writer_->write_message(kImageChannel, static_cast<std::uint32_t>(frame.meta.sequence),
                                  static_cast<std::uint64_t>(now), out.written());
  };
  Status status = write_message();
  if (status.code() == StatusCode::kUnavailable) {
    LCDM_RETURN_IF_ERROR(begin_chunk(frame.meta));
    status = write_message();
  }
  if (status) {
    frames_.fetch_add(1, std::memory_order_relaxed);
    bytes_.fetch_add(jpeg->size(), std::memory_order_relaxed);
  }
  return status;
}

Status Recorder::begin_chunk(const FrameMeta& meta) {
  LCDM_RETURN_IF_ERROR(writer_->end_chunk());
  chunk_begin_ns_ = meta.unix_ns;
  std::array<std::byte, kCalibrationBytes> message{};
  wire::ByteWriter out(message);
  wire::encode(wire::CameraCalibration{meta.unix_ns, camera_}, out);
  LCDM_CHECK(out.ok());
  return writer_->write_message(kCalibrationChannel, static_cast<std::uint32_t>(meta.sequence),
                                static_cast<std::uint64_t>(meta.unix_ns), out.written());
}

Result<std::span<const std::byte>> Recorder::as_jpeg(const FrameView& frame) {
  if (frame.format.pixel == PixelFormat::kMjpeg) {
    return std::as_bytes(std::span(frame.data, frame.bytes));
  }
  const auto size = encoder_.encode(frame, jpeg_);
  if (!size) return size.status();
  return std::span<const std::byte>(jpeg_).first(*size);
}

// Completes the file, also when the disk is as full as it may be; what went wrong before, or now,
// becomes the status.
void Recorder::finish(const Status& status, const Status& room) {
  taking_ = false;
  Status completed = status ? writer_->finish() : status;
  if (completed) completed = room;
  if (completed && format_changed_) {
    completed = Status::error(StatusCode::kUnavailable,
                              "recording ended: the camera came back with another format; start "
                              "it again");
  }
  file_.close();
  writer_.reset();  // also when nobody stops a recording that ended by itself
  const std::lock_guard lock(mutex_);
  under_way_ = false;  // together with the reason
  if (!completed) fault_ = completed.text();
}

Status Recorder::FileSink::open(const std::string& path, std::int64_t keep_free_bytes) {
  close();
  path_ = path;
  keep_free_bytes_ = keep_free_bytes;
  fd_ = ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0640);
  if (fd_ < 0) return Status::system(errno, "recording: cannot create %s", path.c_str());
  os::sync_folder(fs::path(path).parent_path().c_str());
  return check_room();
}

void Recorder::FileSink::remove() {
  if (fd_ < 0) return;  // what was not opened is not ours
  close();
  std::error_code ignored;  // a disk that fails may refuse this too
  fs::remove(path_, ignored);
}

void Recorder::FileSink::close() {
  if (fd_ >= 0) ::close(fd_);
  fd_ = -1;
}

Status Recorder::FileSink::write(std::span<const std::byte> bytes) {
  while (!bytes.empty()) {
    const ssize_t written = ::write(fd_, bytes.data(), bytes.size());
    if (written < 0 && errno == EINTR) continue;
    if (written <= 0) return Status::system(errno, "recording: cannot write %s", path_.c_str());
    bytes = bytes.subspan(static_cast<std::size_t>(written));
  }
  return Status::ok();
}

Status Recorder::FileSink::flush() {
  if (fdatasync(fd_) != 0) {
    return Status::system(errno, "recording: cannot write %s", path_.c_str());
  }
  struct stat file {};
  if (fstat(fd_, &file) == 0 && file.st_nlink == 0) {
    return Status::error(StatusCode::kIoError, "recording ended: %s was deleted", path_.c_str());
  }
  return Status::ok();
}

Status Recorder::FileSink::check_room() const {
  struct statvfs disk {};
  if (fstatvfs(fd_, &disk) == 0 &&
      static_cast<std::int64_t>(disk.f_bavail) * static_cast<std::int64_t>(disk.f_frsize) <
          keep_free_bytes_) {
    return Status::error(
        StatusCode::kIoError,
        "recording: less than %lld MiB are free on the disk of %s: delete something "
        "(record.keep_free_megabytes)",
        static_cast<long long>(keep_free_bytes_ >> 20), path_.c_str());
  }
  return Status::ok();
}

}  // namespace lcdm
