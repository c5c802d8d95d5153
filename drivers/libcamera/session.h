// What LibcameraCamera has open: libcamera's side of it. How frames come: our thread queues
// requests; libcamera's thread fills their buffers and calls on_complete, which puts the buffer's
// index into a ring; dequeue takes it out there.
#pragma once

#include <array>
#include <condition_variable>
#include <cstdint>
#include <libcamera/libcamera.h>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "firmware/buffer/sequence_counter.h"
#include "firmware/pipeline/camera.h"

namespace lcdm {

// The one manager that a process may have; it ends with its last user. Null: it does not start.
std::shared_ptr<libcamera::CameraManager> shared_libcamera_manager();

// Where a picture lies in the file of its planes.
struct PictureMemory {
  std::size_t offset = 0;
  std::size_t length = 0;
};

// Empty: not in one piece that can be read as `format`. Pure.
std::optional<PictureMemory> picture_memory(std::span<const libcamera::FrameBuffer::Plane> planes,
                                            const FrameFormat& format);

// The period, in microseconds, that a camera with these frame durations keeps when `wanted_us` is
// asked for. Pure.
std::int64_t period_within(const libcamera::ControlInfo& durations, std::int64_t wanted_us);

// Both clocks, read at one moment.
struct Clocks {
  std::int64_t monotonic_ns = 0;
  std::int64_t boottime_ns = 0;  // as monotonic, and goes on while the machine sleeps
};

// The moment on CLOCK_MONOTONIC that the stamp of a frame means which is there `now`. Empty: none
// that can be. Pure.
std::optional<std::int64_t> monotonic_stamp(std::int64_t stamp_ns, const Clocks& now);

// Threads: as Camera, and libcamera's own, which calls the two on_ functions.
class LibcameraSession {
 public:
  explicit LibcameraSession(std::string id) : id_(std::move(id)) {}
  ~LibcameraSession() { close(); }
  LibcameraSession(const LibcameraSession&) = delete;
  LibcameraSession& operator=(const LibcameraSession&) = delete;

  Status configure(const CaptureRequest& request);
  Status start();
  Result<CapturedFrame> dequeue(std::chrono::milliseconds timeout);
  Status requeue(int index);
  void stop();
  void close();
  CameraInfo info() const;

  FrameFormat format;
  CameraModel model;
  int buffer_count() const { return static_cast<int>(slots_.size()); }

  static constexpr std::size_t kMostBuffers = 32;

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
    std::int64_t arrival_ns = 0;           // CLOCK_MONOTONIC
    std::optional<std::int64_t> stamp_ns;  // as that; empty: it can be none
    std::size_t bytes = 0;
  };

  Status open(const CaptureRequest& request);
  Status choose_format(const CaptureRequest& request);
  Status map_buffers();
  Status map_slot(Slot& slot) const;
  void set_controls(const CaptureRequest& request);
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
  // What the stamps mean: kArrival from the first useless one to the next opening.
  StampSource stamp_ = StampSource::kStartOfExposure;
  bool running_ = false;

  std::mutex mutex_;  // guards what follows, which libcamera's thread writes
  std::condition_variable filled_;
  std::array<Completed, kMostBuffers> ring_{};
  std::size_t ring_begin_ = 0;
  std::size_t ring_size_ = 0;
  bool gone_ = false;
};

}  // namespace lcdm
