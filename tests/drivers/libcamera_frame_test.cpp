// What is believed of what a libcamera camera says: its rate, its stamps.
#include <cstdint>
#include <gtest/gtest.h>
#include <limits>

#include "drivers/libcamera/session.h"

namespace lcdm {
namespace {

TEST(LibcameraRate, IsWantedWhereTheCameraCanAndElseItsNearest) {
  const libcamera::ControlInfo durations(std::int64_t{16'667}, std::int64_t{200'000});
  EXPECT_EQ(period_within(durations, 33'333), 33'333);
  EXPECT_EQ(period_within(durations, 8'333), 16'667) << "120 frames/s of 60";
  EXPECT_EQ(period_within(durations, 1'000'000), 200'000) << "1 frame/s of 5";
}

TEST(LibcameraRate, ABoundThatIsNoDurationBindsNothing) {
  EXPECT_EQ(period_within(libcamera::ControlInfo(), 33'333), 33'333);
  const libcamera::ControlInfo none(std::int64_t{0}, std::int64_t{0});
  EXPECT_EQ(period_within(none, 33'333), 33'333);
}

// A machine that slept for an hour.
constexpr std::int64_t kSecond = 1'000'000'000;
constexpr std::int64_t kFrame = kSecond / 30;
constexpr Clocks kSlept{100 * kSecond, 3700 * kSecond};

TEST(LibcameraStamp, IsReadOnTheClockThatFits) {
  EXPECT_EQ(monotonic_stamp(kSlept.boottime_ns - kFrame, kSlept), kSlept.monotonic_ns - kFrame)
      << "as libcamera promises";
  EXPECT_EQ(monotonic_stamp(kSlept.monotonic_ns - kFrame, kSlept), kSlept.monotonic_ns - kFrame)
      << "as some hand on from the kernel";
}

TEST(LibcameraStamp, OfTwoReadingsThatCanBeTheNearerIsTaken) {
  const Clocks napped{100 * kSecond, 105 * kSecond};
  EXPECT_EQ(monotonic_stamp(napped.boottime_ns - kFrame, napped), napped.monotonic_ns - kFrame);
  EXPECT_EQ(monotonic_stamp(napped.monotonic_ns - kFrame, napped), napped.monotonic_ns - kFrame);
}

TEST(LibcameraStamp, AMachineThatNeverSleptHasOneReading) {
  const Clocks awake{100 * kSecond, 100 * kSecond};
  EXPECT_EQ(monotonic_stamp(awake.monotonic_ns - kFrame, awake), awake.monotonic_ns - kFrame);
  EXPECT_EQ(monotonic_stamp(awake.monotonic_ns, awake), awake.monotonic_ns);
}

TEST(LibcameraStamp, ThatFitsNeitherClockIsNone) {
  constexpr std::int64_t kMost = std::numeric_limits<std::int64_t>::max();
  for (const std::int64_t stamp :
       {std::int64_t{0}, std::int64_t{-1}, kMost, -kMost, kSlept.boottime_ns + 1,
        kSlept.monotonic_ns + 20 * kSecond, kSlept.monotonic_ns - 11 * kSecond}) {
    EXPECT_FALSE(monotonic_stamp(stamp, kSlept)) << stamp;
  }
}

}  // namespace
}  // namespace lcdm
