// A camera that does what the test's script says.
#pragma once

#include <atomic>
#include <functional>
#include <thread>
#include <vector>

#include "firmware/base/check.h"
#include "firmware/base/os.h"
#include "firmware/pipeline/camera.h"

namespace lcdm::test {

// Small RGB frames, or what `format_of` says, every 2 ms. Aborts when it is used against the
// contract, as by giving a buffer back twice.
class FakeCamera final : public Camera {
 public:
  static constexpr int kBuffers = 4;

  // Called with the number of the call, from 0. Set before the pipeline starts; run on its threads.
  std::function<Status(int)> on_configure = [](int) { return Status::ok(); };
  std::function<Status(int)> on_start = [](int) { return Status::ok(); };
  std::function<Status(int)> on_dequeue = [](int) { return Status::ok(); };  // ok: a frame
  std::function<Status(int)> on_requeue = [](int) { return Status::ok(); };
  std::function<void()> on_stop = [] {};
  std::function<FrameFormat(int)> format_of = [](int) {
    return FrameFormat{PixelFormat::kRgb24, 64, 48, 64 * 3};
  };

  float frames_per_second = 500;              // what it says of itself
  StampSource stamp = StampSource::kArrival;  // what it says when opened
  std::function<StampSource(int)> stamp_of;   // of that frame; empty: as said
  std::string usb;

  std::atomic<int> configured{0};  // calls so far
  std::atomic<int> started{0};
  std::atomic<int> stopped{0};
  std::atomic<int> closed{0};  // by close, not by another configure
  std::atomic<bool> open{false};
  std::atomic<int> dequeued{0};
  std::atomic<int> requeued{0};
  std::atomic<int> delivered{0};
  std::atomic<bool> running{false};

  Status configure(const CaptureRequest&) override {
    LCDM_CHECK(!running);
    const int call = configured++;
    open = false;
    LCDM_RETURN_IF_ERROR(on_configure(call));
    format_ = format_of(call);
    pixels_.assign(64 * 1024, 100);
    open = true;
    return Status::ok();
  }
  const FrameFormat& format() const override { return format_; }
  CameraModel model() const override {
    return CameraModel::from_field_of_view(format_.width, format_.height, 65);
  }
  CameraInfo info() const override { return {"fake:", "a fake", frames_per_second, stamp, usb}; }
  int buffer_count() const override { return kBuffers; }

  Status start() override {
    LCDM_CHECK(open);
    LCDM_RETURN_IF_ERROR(on_start(started++));
    running = true;
    sequence_ = 0;
    return Status::ok();
  }
  Result<CapturedFrame> dequeue(std::chrono::milliseconds timeout) override {
    LCDM_CHECK(running);
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
    if (const Status status = on_dequeue(dequeued++); !status) {
      if (status.code() == StatusCode::kTimeout) std::this_thread::sleep_for(timeout / 5);
      return status;
    }
    for (int i = 0; i < kBuffers; ++i) {
      if (lent_[i]) continue;
      lent_[i] = true;
      const StampSource meaning = stamp_of ? stamp_of(delivered) : stamp;
      ++delivered;
      const std::int64_t now = os::monotonic_ns();
      const FrameMeta meta{sequence_++, now, now + os::unix_offset_ns()};
      return CapturedFrame{i, {format_, meta, pixels_.data(), pixels_.size()}, meaning};
    }
    return Status::error(StatusCode::kTimeout, "all buffers are lent");
  }
  Status requeue(int index) override {
    LCDM_CHECK(running && index >= 0 && index < kBuffers && lent_[index]);
    LCDM_RETURN_IF_ERROR(on_requeue(requeued++));
    lent_[index] = false;
    return Status::ok();
  }
  void stop() override {
    on_stop();
    ++stopped;
    running = false;
    for (bool& each : lent_) each = false;
  }
  void close() override {
    stop();
    ++closed;
    open = false;
  }

 private:
  FrameFormat format_;
  std::vector<std::uint8_t> pixels_;
  bool lent_[kBuffers] = {};
  std::uint64_t sequence_ = 0;
};

}  // namespace lcdm::test
