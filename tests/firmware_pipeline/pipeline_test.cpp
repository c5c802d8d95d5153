// The pipeline against a camera that misbehaves in every way a camera can.
#include "firmware/pipeline/pipeline.h"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <mutex>
#include <thread>
#include <vector>

#include "firmware/base/os.h"
#include "tests/firmware_pipeline/fake_camera.h"
#include "tests/firmware_pipeline/tiny_engine.h"

namespace lcdm {
namespace {

using std::chrono::milliseconds;
using test::FakeCamera;
using testing::HasSubstr;

// A frame in work is finished first, which takes a sanitizer far longer.
#ifdef LCDM_SANITIZED
constexpr std::int64_t kStopLimitNs = 10'000'000'000;
#else
constexpr std::int64_t kStopLimitNs = 1'000'000'000;
#endif

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

  FakeCamera camera_;
  RecordingSink sink_;
  std::unique_ptr<Pipeline> pipeline_;
};

Status timeout() { return Status::error(StatusCode::kTimeout, "fake: nothing came"); }

TEST_F(PipelineTest, FramesBecomeDepthInOrder) {
  start();
  ASSERT_TRUE(delivers(8));
  pipeline_->stop();
  const auto sequences = sink_.sequences();
  for (std::size_t i = 1; i < sequences.size(); ++i) EXPECT_GT(sequences[i], sequences[i - 1]);
  const DepthFrame frame = sink_.last();
  EXPECT_EQ(frame.camera.width, 64);
  EXPECT_EQ(frame.camera.height, 64);
  EXPECT_EQ(frame.colour.format.width, 64);
  EXPECT_EQ(frame.colour.format.height, 48);
  EXPECT_GT(frame.inference_ns, 0);
  EXPECT_GE(frame.done_ns, frame.meta.sensor_ns);
}

TEST_F(PipelineTest, HealthTellsWhatHappens) {
  make();
  EXPECT_EQ(health().state, PipelineState::kStopped);
  ASSERT_TRUE(pipeline_->start().is_ok());
  ASSERT_TRUE(reaches(PipelineState::kStreaming));
  ASSERT_TRUE(delivers(8));
  const HealthSnapshot now = health();
  EXPECT_GT(now.frames_per_second, 0);
  EXPECT_GE(now.frame_age_ns, 0);
  EXPECT_GT(now.inference_p50_ns, 0);
  EXPECT_GE(now.inference_p99_ns, now.inference_p50_ns);
  EXPECT_GE(now.captured, now.inferred);
  EXPECT_GE(now.capture_heartbeat_age_ns, 0);
  EXPECT_GE(now.infer_heartbeat_age_ns, 0);
  EXPECT_EQ(pipeline_->fault(), "");
  EXPECT_EQ(pipeline_->source().info.uri, "fake:");
  EXPECT_GT(pipeline_->engine().stats.arena_bytes, 0U);
  pipeline_->stop();
  EXPECT_EQ(health().state, PipelineState::kStopped);
}

TEST_F(PipelineTest, StampsThatProveUselessAreNotCalledBetterThanTheyAre) {
  camera_.stamp = StampSource::kEndOfFrame;
  std::atomic<bool> useless{false};
  camera_.stamp_of = [&](int) {
    return useless ? StampSource::kArrival : StampSource::kEndOfFrame;
  };
  start();
  ASSERT_TRUE(delivers(1));
  EXPECT_EQ(pipeline_->source().info.stamp, StampSource::kEndOfFrame);
  useless = true;
  EXPECT_TRUE(eventually([&] { return pipeline_->source().info.stamp == StampSource::kArrival; }));
  pipeline_->stop();
}

TEST_F(PipelineTest, ASlowConsumerLosesOldFramesNotTime) {
  sink_.work = milliseconds(40);
  start();
  const std::int64_t begin = os::monotonic_ns();
  ASSERT_TRUE(delivers(12));
  const std::int64_t now = os::monotonic_ns();
  // The newest frame, not the oldest of a queue: that would be about as old as the test.
  EXPECT_LT(now - sink_.last().meta.sensor_ns, (now - begin) / 2);
  EXPECT_GT(health().dropped, 10U);
  pipeline_->stop();
}

TEST_F(PipelineTest, AShortSilenceIsOnlyCounted) {
  camera_.on_dequeue = [](int call) { return call == 5 ? timeout() : Status::ok(); };
  start();
  ASSERT_TRUE(delivers(8));
  EXPECT_EQ(health().timeouts, 1U);
  EXPECT_EQ(health().reopened, 0U);
  EXPECT_EQ(health().state, PipelineState::kStreaming);
}

TEST_F(PipelineTest, ALongerSilenceIsDeclaredAndEndsByItself) {
  std::atomic<bool> silent{false};
  camera_.on_dequeue = [&](int) { return silent ? timeout() : Status::ok(); };
  start();
  ASSERT_TRUE(delivers(3));
  silent = true;
  ASSERT_TRUE(reaches(PipelineState::kNoSignal));
  EXPECT_THAT(pipeline_->fault(), HasSubstr("nothing came"));
  EXPECT_GT(health().frame_age_ns, 100'000'000) << "the age of the last frame is told";
  silent = false;
  ASSERT_TRUE(reaches(PipelineState::kStreaming));
  EXPECT_EQ(pipeline_->fault(), "");
  EXPECT_EQ(health().reopened, 0U);
  pipeline_->stop();
}

TEST_F(PipelineTest, ASilenceThatLastsRestartsTheStream) {
  camera_.on_dequeue = [this](int) { return camera_.started == 1 ? timeout() : Status::ok(); };
  start();
  ASSERT_TRUE(reaches(PipelineState::kStreaming));
  EXPECT_EQ(camera_.configured, 1);
  EXPECT_EQ(steps_on(RecoveryRung::kRestartStream), 1U);
  EXPECT_EQ(health().reopened, 0U);
}

TEST_F(PipelineTest, ASilenceThatOutlastsTheRestartReopensTheCamera) {
  camera_.on_dequeue = [this](int) { return camera_.configured == 1 ? timeout() : Status::ok(); };
  start();
  ASSERT_TRUE(reaches(PipelineState::kStreaming));
  EXPECT_EQ(camera_.configured, 2);
  EXPECT_EQ(steps_on(RecoveryRung::kRestartStream), 1U);
  EXPECT_EQ(steps_on(RecoveryRung::kReopen), 1U);
  EXPECT_EQ(health().reopened, 1U);
}

TEST_F(PipelineTest, ASlowCameraIsNotASilentOne) {
  camera_.frames_per_second = 2;  // three periods are longer than this test's patience
  std::atomic<std::int64_t> next_ns{0};
  camera_.on_dequeue = [&](int) {
    const std::int64_t now = os::monotonic_ns();
    if (now < next_ns) return timeout();
    next_ns = now + 500'000'000;
    return Status::ok();
  };
  start();
  ASSERT_TRUE(delivers(4));
  EXPECT_EQ(steps_on(RecoveryRung::kRestartStream), 0U);
}

TEST_F(PipelineTest, AnErrorOfTheDriverRestartsTheStream) {
  camera_.on_dequeue = [](int call) {
    return call == 10 ? Status::error(StatusCode::kIoError, "fake: EIO") : Status::ok();
  };
  start();
  ASSERT_TRUE(eventually([&] { return camera_.started == 2; }));
  ASSERT_TRUE(delivers(8));
  EXPECT_EQ(camera_.configured, 1);
  EXPECT_EQ(steps_on(RecoveryRung::kRestartStream), 1U);
  EXPECT_EQ(health().sequence_gaps, 0U) << "counting anew is no gap";
}

// Devices arrive and ports are reset when the test says so.
class FakePort final : public CameraPort {
 public:
  bool wait_for_arrival(milliseconds timeout) override {
    std::this_thread::sleep_for(timeout);
    return arrived.exchange(false);
  }
  Status reset(const std::string& usb) override {
    ++resets;
    last_usb = usb;
    return on_reset();
  }

  std::function<Status()> on_reset = [] { return Status::ok(); };
  std::atomic<bool> arrived{false};
  std::atomic<int> resets{0};
  std::string last_usb;  // read after stop
};

TEST_F(PipelineTest, ACameraThatIsAbsentAtTheStartIsWaitedFor) {
  std::atomic<bool> away{true};
  camera_.on_configure = [&](int) {
    return away ? Status::error(StatusCode::kNotFound, "fake: plug it in") : Status::ok();
  };
  FakePort port;
  PipelineOptions options = fast();
  options.port = &port;
  start(options);
  EXPECT_EQ(health().state, PipelineState::kNoCamera);
  EXPECT_THAT(pipeline_->fault(), HasSubstr("plug it in"));
  EXPECT_EQ(pipeline_->source().info.uri, "fake:");
  EXPECT_EQ(sink_.count(), 0U);
  away = false;
  ASSERT_TRUE(delivers(3)) << "the engine is prepared when the camera arrives";
  EXPECT_TRUE(reaches(PipelineState::kStreaming));
  EXPECT_GE(steps_on(RecoveryRung::kWaitForDevice), 1U);
  EXPECT_EQ(steps_on(RecoveryRung::kReopen), 0U);
  EXPECT_EQ(pipeline_->source().format.width, 64);
}

TEST_F(PipelineTest, TheNewsOfADeviceCutsTheWaitShort) {
  std::atomic<bool> away{true};
  camera_.on_configure = [&](int) {
    return away ? Status::error(StatusCode::kNotFound, "fake: plug it in") : Status::ok();
  };
  FakePort port;
  PipelineOptions options = fast();
  options.port = &port;
  options.recovery.first_backoff = options.recovery.last_backoff = milliseconds(600'000);
  start(options);
  away = false;
  port.arrived = true;
  ASSERT_TRUE(delivers(3));
}

TEST_F(PipelineTest, WhatOnlyAPersonCanCureIsAnErrorOfStartAlsoWithAPort) {
  camera_.on_configure = [](int) { return Status::system(EACCES, "fake: join the group video"); };
  FakePort port;
  PipelineOptions options = fast();
  options.port = &port;
  make(options);
  EXPECT_EQ(pipeline_->start().code(), StatusCode::kIoError);
  EXPECT_EQ(health().state, PipelineState::kStopped);
}

// Fails at every dequeue until the test clears it.
class BrokenCameraTest : public PipelineTest {
 protected:
  void SetUp() override {
    camera_.usb = "/dev/bus/usb/001/004";
    camera_.on_dequeue = [this](int) {
      return broken ? Status::error(StatusCode::kIoError, "fake: EIO") : Status::ok();
    };
    options_ = fast();
    options_.recovery.last_backoff = milliseconds(20);
    options_.port = &port_;
  }

  std::atomic<bool> broken{true};
  FakePort port_;
  PipelineOptions options_;
};

TEST_F(BrokenCameraTest, APortResetComesAfterReopeningAndCures) {
  port_.on_reset = [this] {
    broken = false;
    return Status::ok();
  };
  start(options_);
  ASSERT_TRUE(reaches(PipelineState::kStreaming));
  pipeline_->stop();
  EXPECT_EQ(port_.last_usb, "/dev/bus/usb/001/004");
  EXPECT_EQ(steps_on(RecoveryRung::kRestartStream), 1U);
  EXPECT_EQ(steps_on(RecoveryRung::kReopen), 3U);
  EXPECT_EQ(steps_on(RecoveryRung::kResetPort), 1U);
  EXPECT_EQ(health().resets_skipped, 0U);
}

TEST_F(BrokenCameraTest, APortThatMayNotBeResetIsPassedOver) {
  port_.on_reset = [] { return Status::system(EACCES, "fake: not allowed"); };
  start(options_);
  ASSERT_TRUE(eventually([&] { return health().resets_skipped >= 2; }));
  EXPECT_EQ(health().state, PipelineState::kNoSignal);
  broken = false;
  ASSERT_TRUE(reaches(PipelineState::kStreaming));
}

TEST_F(BrokenCameraTest, WhatNothingCuresIsHandedToTheOwner) {
  options_.recovery.give_up_after = milliseconds(0);
  start(options_);
  ASSERT_TRUE(reaches(PipelineState::kFault));
  EXPECT_THAT(pipeline_->fault(), HasSubstr("EIO"));
  EXPECT_EQ(steps_on(RecoveryRung::kRestartProcess), 1U);
  EXPECT_FALSE(eventually_quick([&] { return health().state != PipelineState::kFault; }));
  pipeline_->stop();
  EXPECT_FALSE(camera_.running);
}

TEST_F(BrokenCameraTest, ErrorsThatRepeatClimbToThePortWhileDepthStillComes) {
  camera_.on_dequeue = [](int call) {
    return call % 40 == 39 ? Status::error(StatusCode::kIoError, "fake: EIO") : Status::ok();
  };
  options_.recovery.steady_after = options_.recovery.give_up_after = milliseconds(600'000);
  start(options_);
  ASSERT_TRUE(eventually([&] { return steps_on(RecoveryRung::kResetPort) >= 1; }));
  EXPECT_EQ(steps_on(RecoveryRung::kRestartProcess), 0U);
  EXPECT_TRUE(delivers(5));
}

class PipelineFault : public PipelineTest, public testing::WithParamInterface<StatusCode> {};

TEST_P(PipelineFault, AFailingCameraIsClosedAndOpenedAgain) {
  camera_.on_dequeue = [this](int call) {
    if (call == 10) return Status::error(GetParam(), "fake: unplugged");
    return Status::ok();
  };
  start();
  ASSERT_TRUE(eventually([&] { return camera_.configured == 2; }));
  ASSERT_TRUE(reaches(PipelineState::kStreaming));
  ASSERT_TRUE(delivers(8));
  EXPECT_EQ(health().reopened, 1U);
  EXPECT_EQ(health().sequence_gaps, 0U) << "counting anew is no gap";
  EXPECT_EQ(pipeline_->fault(), "");
}

INSTANTIATE_TEST_SUITE_P(EveryCode, PipelineFault,
                         testing::Values(StatusCode::kDeviceGone, StatusCode::kUnavailable));

TEST_F(PipelineTest, TheCameraIsClosedOnlyWhenNobodyReadsItsFrames) {
  sink_.work = milliseconds(30);
  std::atomic<int> closed_under_a_reader{0};
  camera_.on_stop = [&] { closed_under_a_reader += sink_.busy ? 1 : 0; };
  camera_.on_dequeue = [](int call) {
    return call % 10 == 9 ? Status::error(StatusCode::kDeviceGone, "fake: unplugged")
                          : Status::ok();
  };
  start();
  ASSERT_TRUE(eventually([&] { return camera_.stopped >= 2; }));
  pipeline_->stop();
  EXPECT_EQ(closed_under_a_reader, 0);
}

TEST_F(PipelineTest, ACameraThatStaysAwayIsTriedForEver) {
  std::atomic<bool> away{false};
  camera_.on_dequeue = [&](int) {
    return away ? Status::error(StatusCode::kDeviceGone, "fake: unplugged") : Status::ok();
  };
  camera_.on_configure = [&](int) {
    return away ? Status::error(StatusCode::kNotFound, "fake: plug it in") : Status::ok();
  };
  start();
  ASSERT_TRUE(delivers(3));
  away = true;
  ASSERT_TRUE(eventually([&] { return camera_.configured >= 6; }));
  EXPECT_EQ(health().state, PipelineState::kNoCamera);
  EXPECT_THAT(pipeline_->fault(), HasSubstr("plug it in"));
  EXPECT_GT(health().frame_age_ns, 0) << "the age of the last frame is told";
  EXPECT_FALSE(camera_.running);
  away = false;
  ASSERT_TRUE(reaches(PipelineState::kStreaming));
  EXPECT_EQ(health().reopened, 1U) << "attempts that failed do not count";
}

TEST_F(PipelineTest, ACameraThatComesBackDifferentGetsANewEngine) {
  camera_.format_of = [](int call) {
    return call == 0 ? FrameFormat{PixelFormat::kRgb24, 64, 48, 64 * 3}
                     : FrameFormat{PixelFormat::kYuyv, 96, 48, 96 * 2};
  };
  camera_.on_dequeue = [](int call) {
    return call == 10 ? Status::error(StatusCode::kDeviceGone, "fake: unplugged") : Status::ok();
  };
  start();
  ASSERT_TRUE(eventually([&] { return sink_.last().colour.format.pixel == PixelFormat::kYuyv; }));
  ASSERT_TRUE(delivers(8));
  EXPECT_EQ(pipeline_->source().format.width, 96);
  EXPECT_EQ(health().failed, 0U);
}

TEST_F(PipelineTest, BrokenFramesAreCountedAndPassedOver) {
  camera_.on_dequeue = [](int call) {
    return call % 3 == 0 ? Status::error(StatusCode::kCorrupt, "fake: broken") : Status::ok();
  };
  start();
  ASSERT_TRUE(delivers(8));
  EXPECT_GE(health().corrupt, 2U);
  EXPECT_TRUE(reaches(PipelineState::kStreaming));
  EXPECT_EQ(health().reopened, 0U);
}

TEST_F(PipelineTest, NothingButBrokenFramesIsNoSignal) {
  camera_.on_dequeue = [](int call) {
    return call > 10 ? Status::error(StatusCode::kCorrupt, "fake: broken") : Status::ok();
  };
  start();
  ASSERT_TRUE(reaches(PipelineState::kNoSignal));
  EXPECT_THAT(pipeline_->fault(), HasSubstr("broken"));
  EXPECT_TRUE(eventually([&] { return steps_on(RecoveryRung::kReopen) >= 1; }))
      << "a camera that sends nothing else is restarted, then reopened";
}

TEST_F(PipelineTest, AFiniteSourceEndsAfterItsLastDepth) {
  camera_.on_dequeue = [this](int call) {
    // Each frame waits for the depth of the one before: nothing is skipped.
    eventually([&] { return sink_.count() >= static_cast<std::size_t>(std::min(call, 5)); });
    return call < 5 ? Status::ok() : Status::error(StatusCode::kEndOfStream, "fake: the end");
  };
  start();
  ASSERT_TRUE(reaches(PipelineState::kFinished));
  EXPECT_EQ(sink_.sequences(), (std::vector<std::uint64_t>{0, 1, 2, 3, 4}));
}

TEST_F(PipelineTest, LostFramesOfTheSourceAreGaps) {
  Health health;
  for (const std::uint64_t sequence : {7U, 8U, 11U, 12U, 20U}) health.note_captured(sequence);
  EXPECT_EQ(health.snapshot(0).sequence_gaps, 2U + 7U);
}

TEST_F(PipelineTest, AMissingCameraIsAnErrorOfStart) {
  camera_.on_configure = [](int) {
    return Status::error(StatusCode::kNotFound, "fake: plug it in");
  };
  make();
  const Status status = pipeline_->start();
  EXPECT_EQ(status.code(), StatusCode::kNotFound);
  EXPECT_EQ(health().state, PipelineState::kStopped);
  EXPECT_EQ(camera_.started, 0);
}

TEST_F(PipelineTest, ACameraThatDoesNotStartIsClosed) {
  camera_.on_start = [](int) { return Status::error(StatusCode::kIoError, "fake: no bandwidth"); };
  make();
  EXPECT_EQ(pipeline_->start().code(), StatusCode::kIoError);
  EXPECT_EQ(camera_.stopped, 1);
}

TEST_F(PipelineTest, AnEngineThatCannotBeMadeIsAnErrorOfStart) {
  Pipeline pipeline(
      camera_,
      [](const FrameFormat&, const CameraModel&,
         const Pipeline::Alive&) -> Result<std::unique_ptr<Engine>> {
        return Status::error(StatusCode::kInvalidInput, "fake: no such size");
      },
      nullptr, {&sink_}, fast());
  EXPECT_EQ(pipeline.start().code(), StatusCode::kInvalidInput);
  EXPECT_FALSE(camera_.running);
  EXPECT_EQ(camera_.stopped, 1) << "nothing stays open";
}

TEST_F(PipelineTest, StopsWithinASecondInEveryState) {
  PipelineOptions options = fast();
  options.recovery.first_backoff = options.recovery.last_backoff = milliseconds(60'000);
  std::atomic<bool> away{false};
  camera_.on_dequeue = [&](int) {
    return away ? Status::error(StatusCode::kDeviceGone, "fake: unplugged") : Status::ok();
  };
  for (const bool waiting : {false, true}) {
    away = false;
    start(options);
    ASSERT_TRUE(delivers(2));
    away = waiting;
    if (waiting) {
      ASSERT_TRUE(reaches(PipelineState::kNoCamera));
    }
    const std::int64_t begin = os::monotonic_ns();
    pipeline_->stop();
    EXPECT_LT(os::monotonic_ns() - begin, kStopLimitNs) << "waiting: " << waiting;
    EXPECT_FALSE(camera_.running);
    pipeline_->stop();  // again is harmless
  }
}

// Gives RGB of the frame's size; every third frame is "broken".
class FakeDecoder final : public FrameDecoder {
 public:
  Result<FrameFormat> prepare(const FrameFormat& compressed) override {
    format_ = {PixelFormat::kRgb24, compressed.width, compressed.height, compressed.width * 3};
    pixels_.assign(
        static_cast<std::size_t>(format_.stride) * static_cast<std::size_t>(format_.height), 50);
    return format_;
  }
  Result<FrameView> decode(const FrameView& frame) noexcept override {
    if (++calls_ % 3 == 0 || all_broken) {
      return Status::error(StatusCode::kCorrupt, "fake: broken JPEG");
    }
    return FrameView{format_, frame.meta, pixels_.data(), pixels_.size()};
  }

  std::atomic<bool> all_broken{false};

 private:
  FrameFormat format_;
  std::vector<std::uint8_t> pixels_;
  int calls_ = 0;
};

TEST_F(PipelineTest, CompressedFramesAreDecodedFirst) {
  camera_.format_of = [](int) { return FrameFormat{PixelFormat::kMjpeg, 80, 60, 0}; };
  FakeDecoder decoder;
  start(fast(), &decoder);
  ASSERT_TRUE(delivers(8));
  EXPECT_EQ(sink_.last().colour.format.pixel, PixelFormat::kMjpeg) << "as it came";
  EXPECT_EQ(sink_.last().pixels.format.pixel, PixelFormat::kRgb24);
  EXPECT_EQ(sink_.last().pixels.format.width, 80);
  EXPECT_GT(health().corrupt, 2U);
  EXPECT_TRUE(reaches(PipelineState::kStreaming));
  decoder.all_broken = true;
  ASSERT_TRUE(reaches(PipelineState::kNoSignal)) << "frames come, but none can be used";
  EXPECT_THAT(pipeline_->fault(), HasSubstr("broken JPEG"));
  ASSERT_TRUE(eventually([&] { return steps_on(RecoveryRung::kReopen) >= 1; }));
  decoder.all_broken = false;
  EXPECT_TRUE(reaches(PipelineState::kStreaming));
  pipeline_->stop();
}

TEST_F(PipelineTest, CompressedFramesWithoutADecoderAreRefused) {
  camera_.format_of = [](int) { return FrameFormat{PixelFormat::kMjpeg, 80, 60, 0}; };
  make();
  EXPECT_EQ(pipeline_->start().code(), StatusCode::kUnsupported);
}

// An engine of another size stands for the smaller network.
TEST_F(PipelineTest, LessEffortIsTheSmallerNetworkFromTheNextFrameOn) {
  Pipeline pipeline(camera_, test::tiny_engine(), nullptr, {&sink_}, fast(), test::tiny_engine(96));
  ASSERT_TRUE(pipeline.start().is_ok());
  ASSERT_TRUE(eventually([&] { return sink_.last().camera.width == 64; }));
  EXPECT_EQ(pipeline.engine().stats.width, 64);
  pipeline.set_effort(Effort::kSmallNetwork);
  ASSERT_TRUE(eventually([&] { return sink_.last().camera.width == 96; }));
  EXPECT_EQ(pipeline.engine().stats.width, 96);
  EXPECT_EQ(pipeline.engine().depth_camera.width, 96);
  EXPECT_TRUE(pipeline.has_small_engine());
  pipeline.set_effort(Effort::kFull);
  ASSERT_TRUE(eventually([&] { return sink_.last().camera.width == 64; }));
  EXPECT_EQ(pipeline.health().snapshot(os::monotonic_ns()).skipped, 0U);
}

TEST_F(PipelineTest, AtLeastEffortThereAreRestsBetweenFrames) {
  Pipeline pipeline(camera_, test::tiny_engine(), nullptr, {&sink_}, fast(), test::tiny_engine(96));
  pipeline.set_effort(Effort::kSmallNetworkRest);
  ASSERT_TRUE(pipeline.start().is_ok());
  const auto skipped = [&] { return pipeline.health().snapshot(os::monotonic_ns()).skipped; };
  ASSERT_TRUE(eventually([&] { return skipped() >= 5 && sink_.count() >= 5; }));
  EXPECT_EQ(pipeline.health().state(), PipelineState::kStreaming);
}

TEST_F(PipelineTest, WithoutASmallerNetworkTheOnlyOneGoesOn) {
  start();
  EXPECT_FALSE(pipeline_->has_small_engine());
  pipeline_->set_effort(Effort::kSmallNetwork);
  ASSERT_TRUE(delivers(5));
  EXPECT_EQ(sink_.last().camera.width, 64);
  EXPECT_EQ(health().skipped, 0U);
  pipeline_->set_effort(Effort::kRest);
  ASSERT_TRUE(eventually([&] { return health().skipped >= 5; }));
  EXPECT_EQ(sink_.last().camera.width, 64);
}

TEST_F(PipelineTest, ASmallerNetworkThatIsNotMadeIsKnown) {
  const auto none = [](const FrameFormat&, const CameraModel&,
                       const Pipeline::Alive&) -> Result<std::unique_ptr<Engine>> {
    return std::unique_ptr<Engine>();
  };
  Pipeline pipeline(camera_, test::tiny_engine(), nullptr, {&sink_}, fast(), none);
  EXPECT_TRUE(pipeline.has_small_engine()) << "nobody knows better yet";
  ASSERT_TRUE(pipeline.start().is_ok());
  EXPECT_FALSE(pipeline.has_small_engine());
}

// Each step towards an engine beats the heart of the infer thread, which makes it.
TEST_F(PipelineTest, AnEngineInTheMakingIsASignOfLife) {
  Pipeline* running = nullptr;
  std::atomic<int> beats{0};
  const auto slow = [&](const FrameFormat& format, const CameraModel& camera,
                        const Pipeline::Alive& alive) {
    const std::int64_t before_ns = os::monotonic_ns();
    const std::uint64_t steps = running->health().snapshot(before_ns).prepared;
    alive();
    const HealthSnapshot after = running->health().snapshot(before_ns);
    if (after.prepared == steps + 1 && after.infer_heartbeat_age_ns == 0) ++beats;
    return test::tiny_engine()(format, camera, alive);
  };
  Pipeline pipeline(camera_, slow, nullptr, {&sink_}, fast(), slow);
  running = &pipeline;
  ASSERT_TRUE(pipeline.start().is_ok());
  EXPECT_EQ(beats, 2);
  EXPECT_EQ(pipeline.health().snapshot(0).prepared, 2U + 3U) << "and before, between and behind";
}

}  // namespace
}  // namespace lcdm
