// Depth as colours: near is warm, unknown is black, and the picture does not flicker.
#include "app/depth_colour.h"

#include <gtest/gtest.h>
#include <vector>

namespace lcdm {
namespace {

TEST(DepthColour, NearIsWarmFarIsCoolUnknownIsBlack) {
  DepthColour colour;
  colour.set_range({1000, 10000});
  const Rgb near = colour(1000);
  const Rgb far = colour(10000);
  EXPECT_GT(near.r, near.b + 50);
  EXPECT_GT(far.b, far.g);
  EXPECT_EQ(colour(0).r + colour(0).g + colour(0).b, 0);
}

TEST(DepthColour, BeyondTheRangeTheColourStays) {
  DepthColour colour;
  colour.set_range({1000, 10000});
  const auto same = [](Rgb a, Rgb b) { return a.r == b.r && a.g == b.g && a.b == b.b; };
  EXPECT_TRUE(same(colour(10), colour(1000)));
  EXPECT_TRUE(same(colour(65535), colour(10000)));
}

// Values of Google's published Turbo table (indices 0, 128 and 255), within what the polynomial
// gives away.
TEST(Turbo, IsGooglesTurbo) {
  const auto expect_near = [](float x, int r, int g, int b) {
    const Rgb c = turbo(x);
    EXPECT_NEAR(c.r, r, 35) << x;
    EXPECT_NEAR(c.g, g, 35) << x;
    EXPECT_NEAR(c.b, b, 35) << x;
  };
  expect_near(0.0F, 48, 18, 59);
  expect_near(128.0F / 255, 164, 252, 60);
  expect_near(1.0F, 122, 4, 3);
}

TEST(DepthRange, HoldsAllButTheOutermostValues) {
  std::vector<std::uint16_t> depth;
  for (int i = 0; i < 1000; ++i) depth.push_back(static_cast<std::uint16_t>(1000 + 10 * i));
  depth.insert(depth.end(), 500, 0);  // unknown counts for nothing
  depth.insert(depth.end(), 5, 65535);
  const auto range = range_of(depth);
  ASSERT_TRUE(range.has_value());
  EXPECT_NEAR(range->nearest, 1200, 70);
  EXPECT_NEAR(range->farthest, 10850, 120);
}

TEST(DepthRange, IsEmptyWhereNothingIsKnown) {
  EXPECT_FALSE(range_of(std::vector<std::uint16_t>(100, 0)).has_value());
  EXPECT_FALSE(range_of({}).has_value());
}

TEST(DepthRange, NeverShowsAFlatWallAsNoise) {
  const auto range = range_of(std::vector<std::uint16_t>(100, 2000));
  ASSERT_TRUE(range.has_value());
  EXPECT_GE(range->farthest, 1.5F * range->nearest);
}

TEST(DepthRange, MovesSmoothlyTowardsItsTarget) {
  DepthRange range{1000, 10000};
  const DepthRange target{2000, 40000};
  const DepthRange step = approach(range, target);
  EXPECT_GT(step.nearest, range.nearest);
  EXPECT_LT(step.nearest, 1.25F * range.nearest);
  for (int i = 0; i < 200; ++i) range = approach(range, target);
  EXPECT_NEAR(range.nearest, 2000, 1);
  EXPECT_NEAR(range.farthest, 40000, 10);
}

}  // namespace
}  // namespace lcdm
