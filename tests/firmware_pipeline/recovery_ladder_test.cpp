// The ladder by a clock that the test moves: order of the rungs, back-off, when it begins anew and
// when it ends.
#include "firmware/pipeline/recovery_ladder.h"

#include <gtest/gtest.h>
#include <vector>

namespace lcdm {
namespace {

using std::chrono::milliseconds;
using Rung = RecoveryRung;

constexpr std::int64_t kMs = 1'000'000;

class RecoveryLadderTest : public testing::Test {
 protected:
  // What the ladder says to one more fault, its wait being over.
  Rung rung_after(StatusCode fault) {
    const RecoveryStep step = ladder_.next(fault, now_ns_);
    last_wait_ = step.wait;
    now_ns_ += step.wait.count() * kMs;
    return step.rung;
  }
  std::vector<Rung> rungs_after(StatusCode fault, int faults) {
    std::vector<Rung> rungs;
    for (int i = 0; i < faults; ++i) rungs.push_back(rung_after(fault));
    return rungs;
  }
  void depth_for(milliseconds time) {
    for (milliseconds passed{0}; passed <= time; passed += milliseconds(100)) {
      ladder_.note_depth(now_ns_ += 100 * kMs);
    }
  }

  std::int64_t now_ns_ = 5000 * kMs;
  RecoveryLadder ladder_{{}, now_ns_};
  milliseconds last_wait_{0};
};

TEST_F(RecoveryLadderTest, ClimbsFromTheStreamToThePort) {
  EXPECT_EQ(rungs_after(StatusCode::kIoError, 9),
            (std::vector<Rung>{Rung::kRestartStream, Rung::kReopen, Rung::kReopen, Rung::kReopen,
                               Rung::kResetPort, Rung::kReopen, Rung::kReopen, Rung::kReopen,
                               Rung::kResetPort}));
}

TEST_F(RecoveryLadderTest, WhereNothingIsOpenItBeginsByOpening) {
  ladder_.note_nothing_open();
  EXPECT_EQ(rungs_after(StatusCode::kIoError, 4),
            (std::vector<Rung>{Rung::kReopen, Rung::kReopen, Rung::kReopen, Rung::kResetPort}));
}

TEST_F(RecoveryLadderTest, SilenceAndBrokenFramesAreFaultsLikeAnyOther) {
  for (const StatusCode fault : {StatusCode::kTimeout, StatusCode::kCorrupt}) {
    ladder_ = RecoveryLadder({}, now_ns_);
    EXPECT_EQ(rung_after(fault), Rung::kRestartStream);
    EXPECT_EQ(rung_after(fault), Rung::kReopen);
  }
}

TEST_F(RecoveryLadderTest, ASourceThatChangedIsReopenedAtOnce) {
  EXPECT_EQ(rung_after(StatusCode::kUnavailable), Rung::kReopen);
}

// Hours are no reason for a new process either.
TEST_F(RecoveryLadderTest, ThePortUnderAnotherProgramIsLeftAlone) {
  EXPECT_EQ(rungs_after(StatusCode::kUnavailable, 10'000),
            std::vector<Rung>(10'000, Rung::kReopen));
}

TEST_F(RecoveryLadderTest, WaitsTwiceAsLongEachTimeUpToASecond) {
  std::vector<int> waits;
  for (int i = 0; i < 7; ++i) {
    rung_after(StatusCode::kIoError);
    waits.push_back(static_cast<int>(last_wait_.count()));
  }
  EXPECT_EQ(waits, (std::vector<int>{100, 200, 400, 800, 1000, 1000, 1000}));
}

TEST_F(RecoveryLadderTest, ADeviceThatIsGoneIsWaitedForWithoutEnd) {
  for (int i = 0; i < 10'000; ++i) {
    ASSERT_EQ(rung_after(i == 0 ? StatusCode::kDeviceGone : StatusCode::kNotFound),
              Rung::kWaitForDevice);
  }
  EXPECT_EQ(last_wait_, milliseconds(1000));
}

TEST_F(RecoveryLadderTest, ADeviceThatCameBackAndFailsIsReopenedNotRestarted) {
  rung_after(StatusCode::kDeviceGone);
  EXPECT_EQ(rung_after(StatusCode::kIoError), Rung::kReopen) << "nothing is open to restart";
}

TEST_F(RecoveryLadderTest, SteadyDepthBringsItBackToTheBottom) {
  rungs_after(StatusCode::kIoError, 5);
  depth_for(milliseconds(10'000));
  EXPECT_EQ(rung_after(StatusCode::kIoError), Rung::kRestartStream);
  EXPECT_EQ(last_wait_, milliseconds(100));
}

TEST_F(RecoveryLadderTest, DepthForTheLongestWaitMakesTheNextOneShortButNoLowerRung) {
  rungs_after(StatusCode::kIoError, 4);
  depth_for(milliseconds(900));
  EXPECT_EQ(rung_after(StatusCode::kIoError), Rung::kResetPort);
  EXPECT_EQ(last_wait_, milliseconds(1000));
  depth_for(milliseconds(1000));
  EXPECT_EQ(rung_after(StatusCode::kIoError), Rung::kReopen);
  EXPECT_EQ(last_wait_, milliseconds(100));
  EXPECT_EQ(rung_after(StatusCode::kIoError), Rung::kReopen);
  EXPECT_EQ(last_wait_, milliseconds(200));
}

TEST_F(RecoveryLadderTest, AFewFramesBetweenFaultsDoNot) {
  for (int i = 0; i < 4; ++i) {
    rung_after(StatusCode::kIoError);
    depth_for(milliseconds(5000));
  }
  EXPECT_EQ(rung_after(StatusCode::kIoError), Rung::kResetPort);
}

TEST_F(RecoveryLadderTest, GivesUpAMinuteAfterTheLastDepth) {
  const std::int64_t begin = now_ns_;
  Rung rung = Rung::kRestartStream;
  for (int i = 0; i < 1000 && rung != Rung::kRestartProcess; ++i) {
    rung = rung_after(StatusCode::kIoError);
  }
  EXPECT_EQ(rung, Rung::kRestartProcess);
  EXPECT_GE(now_ns_ - begin, 60'000 * kMs);
  EXPECT_LT(now_ns_ - begin, 62'000 * kMs);
}

// A reset takes a USB camera away for a moment, or leaves its node to root for one: that is no new
// beginning, or a process that only its end would cure would reset the port for ever.
TEST_F(RecoveryLadderTest, GivesUpThoughEachResetTakesTheDeviceAwayForAMoment) {
  for (const StatusCode moment : {StatusCode::kNotFound, StatusCode::kUnavailable}) {
    ladder_ = RecoveryLadder({}, now_ns_);
    const std::int64_t begin = now_ns_;
    Rung rung = Rung::kRestartStream;
    for (int i = 0; i < 1000 && rung != Rung::kRestartProcess; ++i) {
      rung = rung_after(StatusCode::kIoError);
      if (rung != Rung::kResetPort) continue;
      EXPECT_NE(rung_after(moment), Rung::kRestartProcess);
    }
    EXPECT_EQ(rung, Rung::kRestartProcess);
    EXPECT_LT(now_ns_ - begin, 180'000 * kMs);
  }
}

TEST_F(RecoveryLadderTest, NeverGivesUpWhileDepthComesNowAndThen) {
  for (int i = 0; i < 100; ++i) {
    ASSERT_NE(rung_after(StatusCode::kCorrupt), Rung::kRestartProcess);
    now_ns_ += 30'000 * kMs;
    ladder_.note_depth(now_ns_);
  }
}

TEST_F(RecoveryLadderTest, TheTimeADeviceWasAwayDoesNotCountAgainstIt) {
  for (int i = 0; i < 1000; ++i) rung_after(StatusCode::kNotFound);
  EXPECT_EQ(rung_after(StatusCode::kIoError), Rung::kReopen);
}

}  // namespace
}  // namespace lcdm
