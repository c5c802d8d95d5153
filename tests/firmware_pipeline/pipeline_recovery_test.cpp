// The pipeline against a camera that misbehaves in every way a camera can, and its way back.
#include <cerrno>
#include <chrono>
#include <functional>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <string>

#include "tests/firmware_pipeline/pipeline_fixture.h"

namespace lcdm {
namespace {

using testing::HasSubstr;

Status timeout() { return Status::error(StatusCode::kTimeout, "fake: nothing came"); }

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

TEST_F(PipelineTest, AStreamThatGaveDepthIsRestartedAsSoonAsItsSilenceIsDeclared) {
  camera_.on_dequeue = [this](int) {
    return camera_.started == 1 && camera_.delivered > 5 ? timeout() : Status::ok();
  };
  PipelineOptions options = fast();
  options.recover_after = milliseconds(600'000);
  start(options);
  ASSERT_TRUE(eventually([&] { return camera_.started == 2; }));
  ASSERT_TRUE(delivers(3));
  EXPECT_EQ(steps_on(RecoveryRung::kRestartStream), 1U);
}

TEST_F(PipelineTest, AFirstFrameMayTakeLonger) {
  std::atomic<bool> warm{false};
  camera_.on_dequeue = [&](int) { return warm ? Status::ok() : timeout(); };
  PipelineOptions options = fast();
  options.recover_after = milliseconds(600'000);
  start(options);
  ASSERT_TRUE(reaches(PipelineState::kNoSignal));
  EXPECT_FALSE(eventually_quick([&] { return camera_.started > 1; }));
  warm = true;
  ASSERT_TRUE(reaches(PipelineState::kStreaming));
  EXPECT_EQ(camera_.started, 1);
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

// Unnoticed the driver would have fewer and fewer of them.
TEST_F(PipelineTest, ABufferThatTheDriverRefusesRestartsTheStream) {
  camera_.on_requeue = [](int call) {
    return call == 5 ? Status::error(StatusCode::kIoError, "fake: EINVAL of VIDIOC_QBUF")
                     : Status::ok();
  };
  start(fast());
  ASSERT_TRUE(eventually([&] { return camera_.requeued > 20; }));
  pipeline_->stop();
  EXPECT_EQ(steps_on(RecoveryRung::kRestartStream), 1U);
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

// Not plugged in until the test says so.
class AbsentCameraTest : public PipelineTest {
 protected:
  void SetUp() override {
    camera_.on_configure = [this](int) {
      return away_ ? Status::error(StatusCode::kNotFound, "fake: plug it in") : Status::ok();
    };
    options_ = fast();
    options_.port = &port_;
  }

  std::atomic<bool> away_{true};
  FakePort port_;
  PipelineOptions options_;
};

TEST_F(AbsentCameraTest, IsWaitedForAtTheStart) {
  start(options_);
  EXPECT_EQ(health().state, PipelineState::kNoCamera);
  EXPECT_THAT(pipeline_->fault(), HasSubstr("plug it in"));
  EXPECT_EQ(pipeline_->source().info.uri, "fake:");
  EXPECT_EQ(sink_.count(), 0U);
  away_ = false;
  ASSERT_TRUE(delivers(3)) << "the engine is prepared when the camera arrives";
  EXPECT_TRUE(reaches(PipelineState::kStreaming));
  EXPECT_GE(steps_on(RecoveryRung::kWaitForDevice), 1U);
  EXPECT_EQ(steps_on(RecoveryRung::kReopen), 0U);
  EXPECT_EQ(pipeline_->source().format.width, 64);
}

TEST_F(AbsentCameraTest, ItsArrivalCutsTheWaitShort) {
  options_.recovery.first_backoff = options_.recovery.last_backoff = milliseconds(600'000);
  start(options_);
  away_ = false;
  port_.arrived = true;
  ASSERT_TRUE(delivers(3));
}

// Plugged in, but it fails when it is opened or started, until the test heals it.
class CameraThatFailsAtTheStartTest : public PipelineTest {
 protected:
  void SetUp() override {
    camera_.usb = "/dev/bus/usb/001/004";
    options_ = fast();
    options_.recovery.last_backoff = milliseconds(20);
    options_.port = &port_;
  }
  Status answer(const Status& fault) const { return broken_ ? fault : Status::ok(); }

  std::atomic<bool> broken_{true};
  FakePort port_;
  PipelineOptions options_;
};

TEST_F(CameraThatFailsAtTheStartTest, IsDeclaredAndReopenedUntilItCanBeOpened) {
  for (const int fault : {EIO, EBUSY, ENOSPC}) {
    broken_ = true;
    camera_.on_configure = [&](int) { return answer(Status::system(fault, "fake: no format")); };
    start(options_);
    EXPECT_EQ(health().state, PipelineState::kNoSignal);
    EXPECT_THAT(pipeline_->fault(), HasSubstr("fake: no format"));
    EXPECT_EQ(pipeline_->source().info.uri, "fake:");
    broken_ = false;
    ASSERT_TRUE(delivers(3)) << "the engine is prepared when it can be opened";
    EXPECT_GE(steps_on(RecoveryRung::kReopen), 1U);
    EXPECT_EQ(steps_on(RecoveryRung::kRestartStream), 0U) << "nothing was open";
    pipeline_->stop();
  }
}

TEST_F(CameraThatFailsAtTheStartTest, IsWaitedForWhileItIsBusy) {
  camera_.on_configure = [&](int) {
    return answer(Status::error(StatusCode::kUnavailable, "fake: busy"));
  };
  start(options_);
  EXPECT_EQ(health().state, PipelineState::kNoSignal);
  broken_ = false;
  EXPECT_TRUE(delivers(3));
}

TEST_F(CameraThatFailsAtTheStartTest, HasItsStreamStartedAgainWhenThatFailed) {
  camera_.on_start = [](int call) {
    return call == 0 ? Status::system(EIO, "fake: no stream") : Status::ok();
  };
  start(options_);
  ASSERT_TRUE(delivers(3));
  EXPECT_EQ(camera_.configured, 1);
  EXPECT_EQ(steps_on(RecoveryRung::kRestartStream), 1U);
}

TEST_F(CameraThatFailsAtTheStartTest, IsCuredByAResetOfItsPort) {
  camera_.on_configure = [&](int) { return answer(Status::system(EIO, "fake: no format")); };
  port_.on_reset = [this] {
    broken_ = false;
    return Status::ok();
  };
  start(options_);
  ASSERT_TRUE(reaches(PipelineState::kStreaming));
  pipeline_->stop();
  EXPECT_EQ(port_.last_usb, "/dev/bus/usb/001/004");
  EXPECT_EQ(steps_on(RecoveryRung::kReopen), 3U);
  EXPECT_EQ(steps_on(RecoveryRung::kResetPort), 1U);
}

// As at boot, before udev has given its node to the group.
TEST_F(CameraThatFailsAtTheStartTest, IsWaitedForUntilItMayBeOpened) {
  for (const int denied : {EACCES, EPERM}) {
    camera_.on_configure = [denied](int call) {
      return call < 10 ? Status::system(denied, "fake: not allowed") : Status::ok();
    };
    camera_.configured = 0;
    make(options_);
    ASSERT_TRUE(pipeline_->start());
    ASSERT_TRUE(reaches(PipelineState::kStreaming));
    pipeline_->stop();
    EXPECT_EQ(steps_on(RecoveryRung::kReopen), 10U) << "and its port is left alone";
  }
}

TEST_F(CameraThatFailsAtTheStartTest, IsAnErrorOfStartWhereOnlyAnotherStartCanCureIt) {
  for (const Status& fault : {Status::error(StatusCode::kUnsupported, "fake: no known format"),
                              Status::error(StatusCode::kInvalidInput, "fake: another shape")}) {
    camera_.on_configure = [&](int) { return fault; };
    make(options_);
    EXPECT_EQ(pipeline_->start().code(), fault.code()) << fault.text();
    EXPECT_EQ(health().state, PipelineState::kStopped);
  }
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

// Of a camera that is held open the kernel would give another node to the one that comes back.
TEST_F(BrokenCameraTest, APortResetComesAfterReopeningAndCures) {
  port_.on_reset = [this] {
    EXPECT_FALSE(camera_.open);
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

// The kernel takes seconds for a device that does not answer.
TEST_F(BrokenCameraTest, AStepThatTakesLongLetsTheHeartBeat) {
  bool beats = false;
  port_.on_reset = [&] {
    const std::int64_t begin_ns = os::monotonic_ns();
    std::int64_t now_ns = begin_ns;
    while (!beats && now_ns - begin_ns < 10'000'000'000) {
      std::this_thread::sleep_for(milliseconds(5));
      now_ns = os::monotonic_ns();
      beats = now_ns - health().capture_heartbeat_age_ns > begin_ns;
    }
    broken = false;
    return Status::ok();
  };
  start(options_);
  ASSERT_TRUE(eventually([&] { return health().state == PipelineState::kStreaming; }));
  pipeline_->stop();
  EXPECT_TRUE(beats);
}

// Other than one that is broken.
TEST_F(BrokenCameraTest, ThePortOfOneThatAnotherProgramHoldsIsNotReset) {
  camera_.on_dequeue = [this](int) {
    return broken ? Status::system(EBUSY, "fake: held") : Status::ok();
  };
  start(options_);
  ASSERT_TRUE(eventually([&] { return steps_on(RecoveryRung::kReopen) >= 8; }));
  broken = false;
  ASSERT_TRUE(reaches(PipelineState::kStreaming));
  EXPECT_EQ(port_.resets, 0);
}

// As a driver may tell of its longest exposure.
TEST_F(BrokenCameraTest, SilenceIsJudgedThoughTheDriverTellsOfALowRate) {
  camera_.frames_per_second = 0.01F;
  camera_.on_dequeue = [](int) { return Status::error(StatusCode::kTimeout, "fake: silence"); };
  start(options_);
  const std::int64_t begin_ns = os::monotonic_ns();
  ASSERT_TRUE(reaches(PipelineState::kNoSignal));
  EXPECT_LT(os::monotonic_ns() - begin_ns, 20'000'000'000) << "long before 300 s";
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
  EXPECT_EQ(camera_.closed, GetParam() == StatusCode::kDeviceGone ? 1 : 0)
      << "one that has gone is let go of at once";
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

}  // namespace
}  // namespace lcdm
