// The light's patterns, told apart by eye, and a button that bounces as buttons do.
#include "firmware/health/indicator.h"

#include <gtest/gtest.h>
#include <set>
#include <string>
#include <vector>

namespace lcdm {
namespace {

constexpr std::int64_t kMs = 1'000'000;

std::vector<DeviceState> all_states() {
  std::vector<DeviceState> states;
  for (std::size_t i = 0; i < kDeviceStates; ++i) states.push_back(static_cast<DeviceState>(i));
  return states;
}

TEST(Light, EveryStateHasAPatternOfItsOwn) {
  std::set<std::string> seen;
  for (const DeviceState state : all_states()) {
    std::string four_seconds;
    for (int step = 0; step < 40; ++step) {
      four_seconds += is_lit(state, step * 100 * kMs) ? '#' : '.';
    }
    EXPECT_TRUE(seen.insert(four_seconds).second) << to_string(state);
    EXPECT_EQ(four_seconds[0], '#') << "a change shows at once: " << to_string(state);
  }
}

TEST(Light, StreamsWithASteadyLightAndBlinksWithAFault) {
  for (int step = 0; step < 100; ++step) {
    EXPECT_TRUE(is_lit(DeviceState::kStreaming, step * 100 * kMs));
    EXPECT_EQ(is_lit(DeviceState::kFault, step * 100 * kMs), step % 2 == 0);
  }
}

class ButtonTest : public testing::Test {
 protected:
  // Looks every `period` for `time` and returns what was told.
  std::vector<Press> hold(bool pressed, std::int64_t time, std::int64_t period = 50 * kMs) {
    std::vector<Press> told;
    for (const std::int64_t end = now_ + time; now_ < end; now_ += period) {
      const Press press = button_.look(pressed, now_);
      if (press != Press::kNone) told.push_back(press);
    }
    return told;
  }

  Button button_;
  std::int64_t now_ = 5000 * kMs;
};

using Told = std::vector<Press>;

TEST_F(ButtonTest, AShortPressIsToldWhenItIsLetGo) {
  EXPECT_EQ(hold(false, 1000 * kMs), Told{});
  EXPECT_EQ(hold(true, 500 * kMs), Told{});
  EXPECT_EQ(hold(false, 1000 * kMs), Told{Press::kShort});
}

TEST_F(ButtonTest, ALongPressIsToldOnceWhileItIsHeld) {
  hold(false, 1000 * kMs);
  EXPECT_EQ(hold(true, 2900 * kMs), Told{});
  EXPECT_EQ(hold(true, 60'000 * kMs), Told{Press::kLong});
  EXPECT_EQ(hold(false, 1000 * kMs), Told{}) << "letting go of it is no short press";
  EXPECT_EQ(hold(true, 300 * kMs), Told{});
  EXPECT_EQ(hold(false, 300 * kMs), Told{Press::kShort});
}

TEST_F(ButtonTest, BouncesAreOnePress) {
  hold(false, 1000 * kMs);
  Told told;
  for (const bool ending : {false, true}) {
    for (int i = 0; i < 10; ++i) {
      for (const Press press : hold(i % 2 == 0, 5 * kMs, kMs)) told.push_back(press);
    }
    for (const Press press : hold(!ending, 200 * kMs, 10 * kMs)) told.push_back(press);
  }
  EXPECT_EQ(told, Told{Press::kShort});
}

TEST_F(ButtonTest, ASpikeIsNoPress) {
  hold(false, 1000 * kMs);
  EXPECT_EQ(hold(true, 30 * kMs, 10 * kMs), Told{});
  EXPECT_EQ(hold(false, 1000 * kMs, 10 * kMs), Told{});
}

TEST_F(ButtonTest, AStuckButtonDoesNotPowerTheDeviceOff) {
  EXPECT_EQ(hold(true, 60'000 * kMs), Told{});
  EXPECT_EQ(hold(false, 1000 * kMs), Told{});
  EXPECT_EQ(hold(true, 300 * kMs), Told{});
  EXPECT_EQ(hold(false, 300 * kMs), Told{Press::kShort}) << "once let go, it is a button";
}

}  // namespace
}  // namespace lcdm
