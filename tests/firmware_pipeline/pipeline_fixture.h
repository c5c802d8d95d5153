// A pipeline on a fake camera, with a sink that remembers.
#pragma once

#include <atomic>
#include <chrono>
#include <gtest/gtest.h>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#include "firmware/base/os.h"
#include "firmware/pipeline/pipeline.h"
#include "tests/firmware_pipeline/fake_camera.h"
#include "tests/firmware_pipeline/tiny_engine.h"

namespace lcdm {

using std::chrono::milliseconds;

// Remembers what it was offered.
class RecordingSink final : public DepthSink {
 public:
  void offer(const DepthFrame& frame) noexcept override {
    busy = true;
    {
      const std::lock_guard lock(mutex_);
      sequences_.push_back(frame.meta.sequence);
      last_ = frame;
    }
    std::this_thread::sleep_for(work);
    busy = false;
  }
  std::vector<std::uint64_t> sequences() const {
    const std::lock_guard lock(mutex_);
    return sequences_;
  }
  std::size_t count() const { return sequences().size(); }
  DepthFrame last() const {
    const std::lock_guard lock(mutex_);
    return last_;
  }

  milliseconds work{0};  // takes this long over a frame, against the rules
  std::atomic<bool> busy{false};

 private:
  mutable std::mutex mutex_;
  std::vector<std::uint64_t> sequences_;
  DepthFrame last_;
};

class PipelineTest : public testing::Test {
 protected:
  // Before what its threads look at in derived fixtures is gone.
  void TearDown() override { pipeline_.reset(); }

  static PipelineOptions fast() {
    PipelineOptions options;
    options.no_signal_after = milliseconds(150);
    options.recover_after = milliseconds(600);
    options.recovery.first_backoff = milliseconds(20);
    options.recovery.last_backoff = milliseconds(80);
    return options;
  }

  void make(PipelineOptions options = fast(), FrameDecoder* decoder = nullptr) {
    pipeline_ = std::make_unique<Pipeline>(camera_, test::tiny_engine(), decoder,
                                           std::vector<DepthSink*>{&sink_}, options);
  }
  void start(PipelineOptions options = fast(), FrameDecoder* decoder = nullptr) {
    make(options, decoder);
    const Status status = pipeline_->start();
    ASSERT_TRUE(status.is_ok()) << status.text();
  }

  // Polls until the condition holds; false after a minute, for a machine that is busy or slowed by
  // a sanitizer.
  template <typename Condition>
  static bool eventually(Condition&& condition) {
    for (int i = 0; i < 12'000; ++i) {
      if (condition()) return true;
      std::this_thread::sleep_for(milliseconds(5));
    }
    return false;
  }
  // For what must not happen: a moment's look.
  template <typename Condition>
  static bool eventually_quick(Condition&& condition) {
    for (int i = 0; i < 20; ++i) {
      if (condition()) return true;
      std::this_thread::sleep_for(milliseconds(5));
    }
    return false;
  }
  bool reaches(PipelineState state) {
    return eventually([&] { return pipeline_->health().state() == state; });
  }
  bool delivers(std::size_t more) {
    const std::size_t target = sink_.count() + more;
    return eventually([&] { return sink_.count() >= target; });
  }
  std::uint64_t steps_on(RecoveryRung rung) const {
    return health().recovery[static_cast<std::size_t>(rung)];
  }
  HealthSnapshot health() const { return pipeline_->health().snapshot(os::monotonic_ns()); }

  test::FakeCamera camera_;
  RecordingSink sink_;
  std::unique_ptr<Pipeline> pipeline_;
};

}  // namespace lcdm
