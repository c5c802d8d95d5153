// `mcap:PATH`: plays a recording (one MCAP file, or a folder of segments) as a camera.
#pragma once

#include <array>
#include <cstdio>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "firmware/pipeline/camera.h"
#include "firmware/wire/foxglove.h"
#include "firmware/wire/mcap_reader.h"

namespace lcdm {

// Delivers the foxglove.CompressedImage messages (JPEG) of the recording, of the first topic that
// has some, with the intrinsics of the foxglove.CameraCalibration beside it. Live playback keeps
// the recorded pace and starts over at the end; offline gives each frame once. A damaged chunk
// costs its frames, reported as kCorrupt; a segment that a power cut ended plays up to its last
// whole chunk. Threads: as Camera. Allocates while it reads: its capture thread is not sealed.
class McapCamera final : public Camera {
 public:
  enum class Playback { kLive, kOffline };

  McapCamera(std::string path, Playback playback);

  Status configure(const CaptureRequest& request) override;
  const FrameFormat& format() const override { return format_; }
  CameraModel model() const override { return model_; }
  CameraInfo info() const override;
  int buffer_count() const override { return kBuffers; }
  Status start() override;
  Result<CapturedFrame> dequeue(std::chrono::milliseconds timeout) override;
  Status requeue(int index) override;
  void stop() override;

 private:
  static constexpr int kBuffers = 6;

  struct Slot {
    std::vector<std::byte> jpeg;
    bool free = true;
  };

  Status open_segment(std::size_t index);
  // The first segment from `index` on that can be opened: a power cut leaves broken ones. The last
  // one's fault where none can.
  Status open_readable_segment(std::size_t index);
  Result<wire::McapMessage> next_message();
  Status keep_calibration(const wire::McapMessage& message);
  const Result<CameraModel>* own_calibration() const;
  Status fetch(std::int64_t deadline_ns);
  Result<FrameFormat> find_first_picture();
  Status inspect_first_frame(float assumed_field_of_view);
  Slot* find_free_slot(int& index);

  const std::string path_;
  const Playback playback_;
  std::vector<std::string> segments_;
  std::size_t segment_ = 0;  // the one being read
  std::unique_ptr<std::FILE, int (*)(std::FILE*)> file_{nullptr, &std::fclose};
  std::unique_ptr<wire::McapReader> reader_;

  FrameFormat format_;
  CameraModel model_;
  std::string topic_;  // of the pictures: the first one's; empty: not known yet
  std::map<std::string, Result<CameraModel>> calibrations_;  // by topic; an error: of no use
  std::array<Slot, kBuffers> slots_;
  std::vector<std::byte> pending_;  // the next frame's JPEG, waiting for its time
  bool has_pending_ = false;
  FrameMeta pending_meta_;
  std::int64_t recorded_origin_ns_ = 0;  // Unix time of the first frame of this stretch
  std::int64_t play_origin_ns_ = 0;      // MONOTONIC time at which it was due; 0: not yet known
  std::int64_t last_due_ns_ = 0;         // MONOTONIC time of the frame before
  std::uint64_t sequence_ = 0;
  bool round_delivered_ = false;  // this round through the recording gave at least one frame
};

}  // namespace lcdm
