// The pipeline: frames become depth, and the ways in which it begins, slows down and ends.
#include "firmware/pipeline/pipeline.h"

#include <algorithm>
#include <chrono>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <vector>

#include "tests/firmware_pipeline/pipeline_fixture.h"

namespace lcdm {
namespace {

using testing::HasSubstr;

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

TEST_F(PipelineTest, ASourceWithoutAPortThatDoesNotStartIsClosed) {
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

TEST_F(PipelineTest, StopsWithoutWaitingInEveryState) {
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
    EXPECT_LT(os::monotonic_ns() - begin, 30'000'000'000) << "waiting: " << waiting;
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
