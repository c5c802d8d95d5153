// Health by a clock that the test moves: counters, rate, percentiles, ages.
#include "firmware/health/health.h"

#include <gtest/gtest.h>

namespace lcdm {
namespace {

constexpr std::int64_t kMs = 1'000'000;

TEST(Health, KnowsNothingBeforeTheFirstFrame) {
  const Health health;
  const HealthSnapshot now = health.snapshot(1000 * kMs);
  EXPECT_EQ(now.state, PipelineState::kStopped);
  EXPECT_EQ(now.frames_per_second, 0);
  EXPECT_LT(now.frame_age_ns, 0);
  EXPECT_LT(now.inference_p50_ns, 0);
  EXPECT_LT(now.capture_heartbeat_age_ns, 0);
}

TEST(Health, RateIsThatOfTheLastFrames) {
  Health health;
  for (int i = 0; i < 300; ++i) health.note_inferred(1, i * 40 * kMs, 10 * kMs, i * 40 * kMs);
  const std::int64_t last = 299 * 40 * kMs;
  EXPECT_NEAR(health.snapshot(last).frames_per_second, 25, 1e-6);
  EXPECT_NEAR(health.snapshot(last + 1000 * kMs).frames_per_second, 25, 1e-6);
  EXPECT_EQ(health.snapshot(last + 10'000 * kMs).frames_per_second, 0) << "nothing for seconds";
}

TEST(Health, AgeIsCountedFromTheSensor) {
  Health health;
  health.note_inferred(9, 1000 * kMs, 80 * kMs, 1100 * kMs);
  const HealthSnapshot now = health.snapshot(1250 * kMs);
  EXPECT_EQ(now.sequence, 9U);
  EXPECT_EQ(now.frame_age_ns, 250 * kMs);
  EXPECT_EQ(now.latency_ns, 100 * kMs);
}

TEST(Health, PercentilesForgetWhatIsLongAgo) {
  Health health;
  for (int i = 0; i < 50; ++i) health.note_inferred(1, 0, 900 * kMs, 1);
  for (int i = 1; i <= 128; ++i) health.note_inferred(1, 0, i * kMs, 1);
  const HealthSnapshot now = health.snapshot(2);
  EXPECT_EQ(now.inference_p50_ns, 64 * kMs);
  EXPECT_EQ(now.inference_p99_ns, 126 * kMs);
}

TEST(Health, ADamagedFrameIsCountedOnceAndNotAsALostOne) {
  Health health;
  health.note_captured(100);
  health.note_damaged();
  health.note_captured(102);
  EXPECT_EQ(health.snapshot(0).sequence_gaps, 0U);
  EXPECT_EQ(health.snapshot(0).corrupt, 1U);
  health.note_damaged();
  health.note_captured(105);
  EXPECT_EQ(health.snapshot(0).sequence_gaps, 1U);
}

TEST(Health, ReopeningStartsTheSequenceAnew) {
  Health health;
  health.note_captured(100);
  health.note_reopened();
  health.note_captured(0);
  health.note_captured(50);
  EXPECT_EQ(health.snapshot(0).sequence_gaps, 49U);
  EXPECT_EQ(health.snapshot(0).captured, 3U);
  EXPECT_EQ(health.snapshot(0).reopened, 1U);
}

}  // namespace
}  // namespace lcdm
