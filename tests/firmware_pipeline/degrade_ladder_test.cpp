// The degrade ladder: when less is done, when more is tried again, and that it never swings.
#include "firmware/health/degrade_ladder.h"

#include <gtest/gtest.h>
#include <string>

namespace lcdm {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr double kCool = 30;
constexpr double kHot = 2;
constexpr double kBetween = 7;  // neither hot nor cool

class DegradeLadderTest : public testing::Test {
 protected:
  Effort pass(int seconds) {
    Effort effort{};
    for (int i = 0; i < 10 * seconds; ++i) {
      facts_.now_ns += kSecond / 10;
      effort = ladder_.judge(facts_);
    }
    return effort;
  }

  LoadFacts facts_ = [] {
    LoadFacts facts;
    facts.now_ns = 1000 * kSecond;
    facts.headroom_celsius = kCool;
    return facts;
  }();
  DegradeLadder ladder_{10};  // ten depths a second are wanted
};

TEST_F(DegradeLadderTest, DoesAllItCanWhenNothingIsWrong) {
  facts_.inference_ns = kSecond / 20;
  EXPECT_EQ(pass(3600), Effort::kFull);
  EXPECT_STREQ(ladder_.reason(), "");
  EXPECT_EQ(ladder_.lowered(), 0U);
}

TEST_F(DegradeLadderTest, KnowsNoHeatWhereThereIsNoSensor) {
  facts_ = {1000 * kSecond};
  EXPECT_EQ(pass(3600), Effort::kFull);
}

TEST_F(DegradeLadderTest, HeatTakesTheSmallerNetworkThenRests) {
  facts_.headroom_celsius = kHot;
  EXPECT_EQ(pass(2), Effort::kFull) << "one reading is no heat";
  EXPECT_EQ(pass(2), Effort::kSmallNetwork);
  EXPECT_STREQ(ladder_.reason(), "the board is hot");
  EXPECT_EQ(pass(10), Effort::kSmallNetwork) << "cooling takes its time";
  EXPECT_EQ(pass(10), Effort::kSmallNetworkRest);
  EXPECT_EQ(pass(600), Effort::kSmallNetworkRest) << "there is no lower rung";
  EXPECT_EQ(ladder_.lowered(), 2U);
}

TEST_F(DegradeLadderTest, ThrottlingCountsAsHeat) {
  facts_.throttled = true;
  EXPECT_EQ(pass(5), Effort::kSmallNetwork);
  EXPECT_STREQ(ladder_.reason(), "the processor is throttled");
}

TEST_F(DegradeLadderTest, ClimbsAgainRungByRungWhenItIsCool) {
  facts_.headroom_celsius = kHot;
  pass(60);
  facts_.headroom_celsius = kBetween;
  EXPECT_EQ(pass(3600), Effort::kSmallNetworkRest) << "not hot is not yet cool";
  facts_.headroom_celsius = kCool;
  EXPECT_EQ(pass(25), Effort::kSmallNetworkRest);
  EXPECT_EQ(pass(10), Effort::kSmallNetwork);
  EXPECT_EQ(pass(35), Effort::kFull);
  EXPECT_STREQ(ladder_.reason(), "");
  EXPECT_EQ(ladder_.raised(), 2U);
}

TEST_F(DegradeLadderTest, AMissedRateTakesTheSmallerNetworkAndNoRest) {
  facts_.inference_ns = kSecond / 8;
  EXPECT_EQ(pass(5), Effort::kSmallNetwork);
  EXPECT_EQ(std::string(ladder_.reason()), "the network is slower than service.least_rate");
  facts_.inference_ns = kSecond / 9;  // still too slow: a rest would make it worse
  EXPECT_EQ(pass(20), Effort::kSmallNetwork);
}

TEST_F(DegradeLadderTest, WithoutAWantedRateNoNetworkIsTooSlow) {
  DegradeLadder ladder(0);
  facts_.inference_ns = 60 * kSecond;
  for (; facts_.now_ns < 2000 * kSecond; facts_.now_ns += kSecond) {
    ASSERT_EQ(ladder.judge(facts_), Effort::kFull);
  }
}

TEST_F(DegradeLadderTest, WithoutASmallerNetworkHeatTakesTheRestsAndSlownessNothing) {
  facts_.has_small_network = false;
  facts_.inference_ns = kSecond / 5;
  EXPECT_EQ(pass(600), Effort::kFull);
  facts_.headroom_celsius = kHot;
  EXPECT_EQ(pass(5), Effort::kRest);
  EXPECT_STREQ(to_string(Effort::kRest), "full network with rests");
  EXPECT_EQ(pass(600), Effort::kRest) << "there is no lower rung";
  EXPECT_EQ(ladder_.lowered(), 1U);
  facts_.headroom_celsius = kCool;
  EXPECT_EQ(pass(60), Effort::kFull);
  EXPECT_STREQ(ladder_.reason(), "");
}

TEST_F(DegradeLadderTest, FollowsASmallerNetworkThatComesOrGoes) {
  facts_.headroom_celsius = kHot;
  EXPECT_EQ(pass(60), Effort::kSmallNetworkRest);
  facts_.has_small_network = false;
  EXPECT_EQ(pass(1), Effort::kRest);
  EXPECT_STREQ(ladder_.reason(), "the board is hot");
  facts_.has_small_network = true;
  EXPECT_EQ(pass(1), Effort::kSmallNetwork);

  facts_.headroom_celsius = kCool;
  EXPECT_EQ(pass(600), Effort::kFull);
  facts_.inference_ns = kSecond / 5;
  EXPECT_EQ(pass(5), Effort::kSmallNetwork);
  facts_.has_small_network = false;
  EXPECT_EQ(pass(1), Effort::kFull) << "a rest would make it slower";
  EXPECT_STREQ(ladder_.reason(), "");
}

TEST_F(DegradeLadderTest, TriesMoreWorkEverMoreSeldomWhileItFails) {
  // A network that is always too slow at full size: each try fails.
  for (int i = 0; i < 3600 * 10; ++i) {
    facts_.now_ns += kSecond / 10;
    facts_.inference_ns = ladder_.judge(facts_) == Effort::kFull ? kSecond / 5 : kSecond / 20;
  }
  EXPECT_GE(ladder_.lowered(), 5U);
  EXPECT_LE(ladder_.lowered(), 12U) << "an hour at one try in 30 s would be 120";
}

}  // namespace
}  // namespace lcdm
