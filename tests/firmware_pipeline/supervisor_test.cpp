// The device's state and the watchdog, played through by a clock that the test moves.
#include "firmware/health/supervisor.h"

#include <functional>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <string>
#include <vector>

namespace lcdm {
namespace {

using testing::HasSubstr;

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kSecond = 1000 * kMs;
constexpr std::int64_t kLookNs = 50 * kMs;

// A device in which everything goes well, until a test says otherwise.
class SupervisorTest : public testing::Test {
 protected:
  // Looks at the device every 50 ms for `ns`, with `happens` before each look.
  void pass(
      std::int64_t ns, const std::function<void()>& happens = [] {}) {
    for (std::int64_t end = seen_.now_ns + ns; seen_.now_ns < end;) {
      seen_.now_ns += kLookNs;
      happens();
      seen_.outputs = outputs_;
      const Judgement& now = supervisor_.judge(seen_);
      if (now.changed) changes_.push_back(std::string(to_string(now.state)) + ": " + now.reason);
      now_ = now;
    }
  }

  // A second in which frames come and become depth.
  void stream(std::int64_t ns = kSecond) {
    seen_.pipeline.state = PipelineState::kStreaming;
    seen_.fault = "";
    pass(ns, [this] {
      ++seen_.pipeline.captured;
      ++seen_.pipeline.inferred;
    });
  }

  // No frame comes, and the pipeline says so.
  void wait(std::int64_t ns, const char* fault = "fake: plug it in",
            PipelineState state = PipelineState::kNoSignal) {
    seen_.pipeline.state = state;
    seen_.fault = fault;
    pass(ns);
  }

  Observation seen_ = [] {
    Observation seen;
    seen.now_ns = 1000 * kSecond;
    seen.pipeline.state = PipelineState::kStarting;
    seen.pipeline.capture_heartbeat_age_ns = 0;
    seen.pipeline.infer_heartbeat_age_ns = 0;
    return seen;
  }();
  std::vector<OutputPulse> outputs_ = {{"encode", -1}, {"record", -1}};
  Supervisor supervisor_;
  Judgement now_;
  std::vector<std::string> changes_;
};

TEST_F(SupervisorTest, BootsAndIsReadyWithTheFirstDepth) {
  pass(2 * kSecond);
  EXPECT_EQ(now_.state, DeviceState::kBooting);
  EXPECT_FALSE(now_.ready);
  stream(kLookNs);
  EXPECT_EQ(now_.state, DeviceState::kStreaming);
  EXPECT_TRUE(now_.ready);
  EXPECT_TRUE(now_.alive);
  EXPECT_EQ(now_.changes, 1U);
}

TEST_F(SupervisorTest, ACameraAbsentAtBootIsADeclaredWait) {
  wait(kLookNs, "fake: plug it in", PipelineState::kNoCamera);
  EXPECT_EQ(now_.state, DeviceState::kWaitingForCamera);
  EXPECT_STREQ(now_.reason, "fake: plug it in");
  EXPECT_TRUE(now_.ready) << "an absent camera does not hold up the boot";
  wait(3600 * kSecond);
  EXPECT_TRUE(now_.alive) << "nor is it a reason to restart";
  stream();
  EXPECT_EQ(now_.state, DeviceState::kStreaming);
  EXPECT_THAT(changes_,
              testing::ElementsAre("waiting for camera: fake: plug it in", "streaming: "));
}

TEST_F(SupervisorTest, EveryChangeIsSaidOnceWithItsReason) {
  stream();
  wait(30 * kSecond, "fake: unplugged");
  stream();
  seen_.recording = true;
  stream();
  seen_.recording = false;
  stream();
  EXPECT_THAT(changes_, testing::ElementsAre("streaming: ", "waiting for camera: fake: unplugged",
                                             "streaming: ", "recording: ", "streaming: "));
  EXPECT_EQ(now_.changes, 4U);
}

TEST_F(SupervisorTest, FramesWithoutDepthStopThePing) {
  stream();
  pass(9 * kSecond, [this] { ++seen_.pipeline.captured; });
  EXPECT_TRUE(now_.alive) << "a slow frame is not a fault";
  pass(2 * kSecond, [this] { ++seen_.pipeline.captured; });
  EXPECT_FALSE(now_.alive);
  EXPECT_EQ(now_.state, DeviceState::kFault);
  EXPECT_THAT(now_.reason, HasSubstr("no depth"));
  stream();
  EXPECT_TRUE(now_.alive) << "it came after all";
  EXPECT_EQ(now_.state, DeviceState::kStreaming);
}

// An engine that refuses every frame makes the pipeline say `no signal` too; but then frames come.
TEST_F(SupervisorTest, ARefusingEngineIsNoWaitForTheCamera) {
  stream();
  seen_.pipeline.state = PipelineState::kNoSignal;
  seen_.fault = "fake: no such format";
  pass(11 * kSecond, [this] { ++seen_.pipeline.captured; });
  EXPECT_EQ(now_.state, DeviceState::kFault);
  EXPECT_FALSE(now_.alive);
  EXPECT_THAT(now_.reason, HasSubstr("no such format"));
}

// Its ladder restarts the stream, reopens, resets the port: that takes its time.
TEST_F(SupervisorTest, ACameraOfBrokenPicturesIsWaitedFor) {
  stream();
  seen_.pipeline.state = PipelineState::kNoSignal;
  seen_.fault = "fake: none can be decoded";
  pass(30 * kSecond, [this] {
    seen_.pipeline.captured += 2;  // one of them gave way to the other
    ++seen_.pipeline.corrupt;
  });
  EXPECT_TRUE(now_.alive);
  EXPECT_EQ(now_.state, DeviceState::kWaitingForCamera);
  pass(20 * kSecond,
       [this] { ++seen_.pipeline.captured, ++seen_.pipeline.corrupt, ++seen_.pipeline.failed; });
  EXPECT_FALSE(now_.alive) << "the engine refuses those that are whole";
}

// However seldom frames come, and though one now and then is broken.
TEST_F(SupervisorTest, ARefusingEngineIsNoWaitAtAnyRate) {
  for (const std::int64_t period : {100 * kMs, kSecond, 1600 * kMs, 2 * kSecond}) {
    for (const std::int64_t damage : {std::int64_t{0}, kSecond, 3 * kSecond}) {
      stream();
      ASSERT_TRUE(now_.alive);
      seen_.pipeline.state = PipelineState::kNoSignal;
      std::int64_t past = 0;
      pass(20 * kSecond, [&] {
        past += kLookNs;
        if (past % period == 0) ++seen_.pipeline.captured, ++seen_.pipeline.failed;
        if (damage > 0 && past % damage == kLookNs)
          ++seen_.pipeline.captured, ++seen_.pipeline.corrupt;
      });
      EXPECT_FALSE(now_.alive) << period << " " << damage;
      EXPECT_EQ(now_.state, DeviceState::kFault);
    }
  }
}

TEST_F(SupervisorTest, AHangingVitalThreadStopsThePing) {
  for (auto age :
       {&HealthSnapshot::capture_heartbeat_age_ns, &HealthSnapshot::infer_heartbeat_age_ns}) {
    stream();
    const std::uint64_t missed = now_.missed_vital;
    seen_.pipeline.*age = 9 * kSecond;
    wait(kSecond);
    EXPECT_TRUE(now_.alive);
    seen_.pipeline.*age = 11 * kSecond;
    wait(5 * kSecond);
    EXPECT_FALSE(now_.alive) << "even in a declared wait";
    EXPECT_EQ(now_.state, DeviceState::kFault);
    EXPECT_EQ(now_.missed_vital, missed + 1) << "one miss, however long";
    seen_.pipeline.*age = 0;
  }
}

TEST_F(SupervisorTest, NamesTheThreadThatHangs) {
  stream();
  seen_.pipeline.infer_heartbeat_age_ns = 11 * kSecond;
  stream(kLookNs);
  EXPECT_STREQ(now_.reason, "thread infer gives no sign of life");
}

TEST_F(SupervisorTest, AGapBetweenLooksIsAMissOfMain) {
  stream();
  seen_.now_ns += 20 * kSecond;
  stream(kLookNs);
  EXPECT_FALSE(now_.alive);
  EXPECT_STREQ(now_.reason, "thread main gives no sign of life");
  EXPECT_EQ(now_.missed_vital, 1U);
  stream();
  EXPECT_TRUE(now_.alive);
}

TEST_F(SupervisorTest, AHangingOutputCostsThatOutputOnly) {
  stream();
  outputs_[1].age_ns = 11 * kSecond;
  stream();
  EXPECT_EQ(now_.state, DeviceState::kDegraded);
  EXPECT_THAT(now_.reason, HasSubstr("record"));
  EXPECT_TRUE(now_.alive) << "a dying card must not kill depth";
  EXPECT_EQ(now_.missed_outputs, 1U);
  EXPECT_EQ(now_.missed_vital, 0U);
  outputs_[1].age_ns = -1;
  stream();
  EXPECT_EQ(now_.state, DeviceState::kStreaming);
}

// A camera came back different: its engine takes a slow board long, but it comes nearer.
TEST_F(SupervisorTest, AnEngineInTheMakingIsProgressUntilItHangs) {
  stream();
  const auto frame = [this] { ++seen_.pipeline.captured; };
  for (int step = 0; step < 6; ++step) {
    ++seen_.pipeline.prepared;
    pass(8 * kSecond, frame);
    EXPECT_TRUE(now_.alive) << "step " << step;
  }
  pass(3 * kSecond, frame);
  EXPECT_FALSE(now_.alive);
  EXPECT_THAT(now_.reason, HasSubstr("no depth for"));
}

TEST_F(SupervisorTest, WhatIsLostIsSaid) {
  stream();
  seen_.output_fault = "recording ended: the disk is full";
  stream();
  EXPECT_EQ(now_.state, DeviceState::kDegraded);
  EXPECT_STREQ(now_.reason, "recording ended: the disk is full");
  seen_.output_fault = "";
  seen_.effort = Effort::kSmallNetwork;
  seen_.effort_reason = "the board is hot";
  stream();
  EXPECT_STREQ(now_.reason, "smaller network: the board is hot");
  const std::size_t before = changes_.size();
  seen_.effort = Effort::kSmallNetworkRest;
  stream();
  EXPECT_EQ(changes_.size(), before + 1) << "another rung is another line";
  EXPECT_TRUE(now_.alive);
}

TEST_F(SupervisorTest, ASecondLossIsSaidBesideTheFirst) {
  seen_.effort = Effort::kSmallNetwork;
  seen_.effort_reason = "the board is hot";
  stream();
  const std::size_t before = changes_.size();
  seen_.output_fault = "recording ended: the disk is full";
  stream();
  EXPECT_STREQ(now_.reason, "recording ended: the disk is full; smaller network: the board is hot");
  EXPECT_EQ(changes_.size(), before + 1);
  seen_.effort_reason = "the board is hotter";
  stream();
  EXPECT_EQ(changes_.size(), before + 1) << "other words are no other loss";
}

// It does not begin again by itself: a device that is well is not called degraded for ever.
TEST_F(SupervisorTest, ARecordingThatEndedByItselfDegradesForAMinute) {
  stream();
  seen_.output_fault = "recording ended: the disk is full";
  stream(59 * kSecond);
  EXPECT_EQ(now_.state, DeviceState::kDegraded);
  stream(2 * kSecond);
  EXPECT_EQ(now_.state, DeviceState::kStreaming);
  seen_.output_fault = "";
  stream();
  seen_.output_fault = "recording ended: the disk is full";
  stream();
  EXPECT_EQ(now_.state, DeviceState::kDegraded) << "each time anew";
}

TEST_F(SupervisorTest, ACameraThatNothingBringsBackIsAFault) {
  stream();
  seen_.pipeline.state = PipelineState::kFault;
  seen_.fault = "fake: no frames";
  pass(kLookNs);
  EXPECT_EQ(now_.state, DeviceState::kFault);
  EXPECT_THAT(now_.reason, HasSubstr("fake: no frames"));
}

TEST_F(SupervisorTest, TheEndOfASourceIsNoFault) {
  stream();
  seen_.pipeline.state = PipelineState::kFinished;
  pass(60 * kSecond);
  EXPECT_TRUE(now_.alive);
}

}  // namespace
}  // namespace lcdm
