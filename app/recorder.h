// Writes colour frames with their stamps and the camera's calibration into MCAP segments.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <semaphore>
#include <string>
#include <thread>
#include <vector>

#include "drivers/codec/codec.h"
#include "firmware/buffer/spsc_ring.h"
#include "firmware/health/heartbeat.h"
#include "firmware/pipeline/depth_sink.h"
#include "firmware/vision/camera_model.h"
#include "firmware/wire/mcap_writer.h"

namespace lcdm {

struct RecorderOptions {
  std::string directory;                       // made when it is not there
  std::int64_t segment_bytes = 256LL << 20;    // a new file after so many
  std::int64_t keep_free_bytes = 512LL << 20;  // recording ends before the disk is fuller
};

struct RecorderStatus {
  bool recording = false;
  std::uint64_t frames = 0;   // written in this recording, or the last one
  std::uint64_t dropped = 0;  // in it: the disk was slower than the camera, or no picture at all
  std::uint64_t bytes = 0;
  std::string file;   // the segment being written, or the last one
  std::string fault;  // why recording ended by itself; empty when it did not
};

// A segment is readable up to its last second at every moment: each chunk holds a second at most
// and is on the medium when it is written. A full or broken disk ends the recording, never the
// depth.
// Threads: start, stop and status on any thread; push and offer on one thread at a time (infer);
// `record` is its own thread and does all the writing.
class Recorder final : public DepthSink {
 public:
  explicit Recorder(RecorderOptions options);
  ~Recorder() override;
  Recorder(const Recorder&) = delete;
  Recorder& operator=(const Recorder&) = delete;

  // Begins a recording of frames of `format`. On error nothing is recorded and no file is left.
  Status start(const std::string& source, const FrameFormat& format, const CameraModel& camera);
  // Ends it and completes the file. Harmless when nothing is recorded.
  void stop();
  RecorderStatus status() const;
  // Of the thread `record`: rests while there is nothing to write.
  const Heartbeat& heartbeat() const { return heartbeat_; }

  // All slots are waiting for the disk.
  bool full() const noexcept { return taking_ && free_.empty(); }
  // Copies the frame for writing. False, without blocking, when it was not taken: not recording,
  // another format, larger than any slot, or full.
  bool push(const FrameView& frame) noexcept;
  // The same, and a frame not taken while recording counts as dropped.
  void push_or_drop(const FrameView& frame) noexcept;
  void offer(const DepthFrame& frame) noexcept override;

 private:
  static constexpr std::size_t kSlots = 8;
  // So many frames of another format, one after the other, are no odd picture in a folder: the
  // camera has changed, and the recording ends.
  static constexpr int kForeignFrames = 10;

  struct Slot {
    std::vector<std::uint8_t> pixels;
    FrameView view;
  };

  class FileSink final : public wire::ByteSink {
   public:
    ~FileSink() override { close(); }
    Status open(const std::string& path, std::int64_t keep_free_bytes);
    void close();
    // Closes and deletes it.
    void remove();
    Status write(std::span<const std::byte> bytes) override;
    // Also ends a recording whose file was deleted.
    Status flush() override;
    // kIoError: the disk is as full as may be.
    Status check_room() const;

   private:
    int fd_ = -1;
    std::int64_t keep_free_bytes_ = 0;
    std::string path_;
  };

  void end();  // control_mutex_ is held
  Status prepare_slots(const FrameFormat& format);
  Status open_segment();
  void record_loop();
  Status write(const FrameView& frame);
  // With the camera's calibration: each chunk stands for itself.
  Status begin_chunk(const FrameMeta& meta);
  Result<std::span<const std::byte>> as_jpeg(const FrameView& frame);
  void finish(const Status& status, const Status& room);

  const RecorderOptions options_;

  std::array<Slot, kSlots> slots_;
  SpscRing<std::size_t, kSlots> filled_;  // infer -> record
  SpscRing<std::size_t, kSlots> free_;    // record -> infer
  std::counting_semaphore<> work_{0};     // one per entry of filled_, and one to stop
  std::atomic<bool> taking_{false};       // frames; ends before the file is complete
  std::atomic<bool> stopping_{false};
  std::atomic<bool> format_changed_{false};  // only frames come that this recording cannot hold
  std::atomic<std::uint64_t> frames_{0};
  std::atomic<std::uint64_t> dropped_{0};
  std::atomic<std::uint64_t> bytes_{0};
  Heartbeat heartbeat_;

  // The record thread's while it runs, start()'s before.
  FrameFormat format_;
  int foreign_ = 0;  // frames of another format since the last of this one; push_mutex_ guards it
  std::size_t frame_capacity_ = 0;
  CameraModel camera_;
  std::string source_;
  FileSink file_;
  std::optional<wire::McapWriter> writer_;     // its memory only while recording
  std::array<wire::McapChannel, 2> channels_;  // the writer borrows them
  std::vector<std::byte> jpeg_;                // encoder's output
  std::vector<std::byte> message_;             // one encoded message
  JpegEncoder encoder_;
  std::int64_t chunk_begin_ns_ = 0;

  mutable std::mutex mutex_;  // guards what follows
  bool under_way_ = false;
  std::string path_;
  std::string fault_;

  std::mutex control_mutex_;  // one start or stop at a time
  std::mutex push_mutex_;     // held by push, which only tries, and while the slots are made anew
  std::thread thread_;
};

}  // namespace lcdm
