// Offsets from lifetimes.
#include "firmware/nn/memory_plan.h"

#include <gtest/gtest.h>
#include <random>

namespace lcdm {
namespace {

TEST(MemoryPlan, BlocksThatNeverMeetShareMemory) {
  const std::vector<Lifetime> chain = {{1000, 0, 1}, {1000, 1, 2}, {1000, 2, 3}, {1000, 3, 4}};
  const MemoryPlan plan = plan_memory(chain);
  EXPECT_EQ(plan.bytes, 2048U);  // two at a time, each rounded up to 1024
  EXPECT_EQ(plan.offsets, (std::vector<std::size_t>{0, 1024, 0, 1024}));
}

TEST(MemoryPlan, SmallBlocksFillTheGapsBetweenLargeOnes) {
  const std::vector<Lifetime> blocks = {{64, 0, 9}, {640, 0, 3}, {320, 4, 9}, {256, 5, 6}};
  EXPECT_EQ(plan_memory(blocks).bytes, 704U);
}

TEST(MemoryPlan, NothingToPlaceNeedsNothing) {
  EXPECT_EQ(plan_memory({}).bytes, 0U);
  const std::vector<Lifetime> empty = {{0, 0, 5}};
  EXPECT_EQ(plan_memory(empty).bytes, 0U);
  EXPECT_EQ(plan_memory(empty, 64).bytes, 0U);
}

TEST(MemoryPlan, AGapStaysFreeBehindEachBlock) {
  const std::vector<Lifetime> chain = {{1000, 0, 1}, {1000, 1, 2}, {1000, 2, 3}};
  const MemoryPlan plan = plan_memory(chain, 128);
  EXPECT_EQ(plan.offsets, (std::vector<std::size_t>{0, 1152, 0}));
  EXPECT_EQ(plan.bytes, 2304U);
}

TEST(MemoryPlan, RandomLifetimesNeverOverlapInTimeAndSpace) {
  std::mt19937 random(1);
  for (int round = 0; round < 200; ++round) {
    std::vector<Lifetime> blocks(1 + random() % 40);
    for (Lifetime& block : blocks) {
      const int first = static_cast<int>(random() % 30);
      block = {random() % 5000, first, first + static_cast<int>(random() % 10)};
    }
    const MemoryPlan plan = plan_memory(blocks);
    std::size_t busiest = 0;
    for (int step = 0; step < 40; ++step) {
      std::size_t live = 0;
      for (const Lifetime& b : blocks) {
        if (b.first <= step && step <= b.last) live += b.bytes;
      }
      busiest = std::max(busiest, live);
    }
    EXPECT_GE(plan.bytes, busiest);
    for (std::size_t i = 0; i < blocks.size(); ++i) {
      ASSERT_EQ(plan.offsets[i] % MemoryPlan::kAlignment, 0U);
      ASSERT_LE(plan.offsets[i] + blocks[i].bytes, plan.bytes);
      for (std::size_t j = 0; j < i; ++j) {
        const bool same_time =
            blocks[i].first <= blocks[j].last && blocks[j].first <= blocks[i].last;
        const bool same_place = plan.offsets[i] < plan.offsets[j] + blocks[j].bytes &&
                                plan.offsets[j] < plan.offsets[i] + blocks[i].bytes;
        ASSERT_FALSE(same_time && same_place) << i << " and " << j;
      }
    }
  }
}

}  // namespace
}  // namespace lcdm
