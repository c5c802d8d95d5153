// Who holds which buffer: the pool, the mailbox and the ring.
#include <gtest/gtest.h>
#include <memory>
#include <thread>
#include <vector>

#include "firmware/buffer/frame_pool.h"
#include "firmware/buffer/mailbox.h"
#include "firmware/buffer/spsc_ring.h"

namespace lcdm {
namespace {

using State = FramePool::State;

void expect_states(const FramePool& pool, int driver, int lent, int returned) {
  EXPECT_EQ(pool.count(State::kDriver), driver);
  EXPECT_EQ(pool.count(State::kLent), lent);
  EXPECT_EQ(pool.count(State::kReturned), returned);
}

TEST(FramePool, TheStatesAlwaysAddUp) {
  FramePool pool(4);
  expect_states(pool, 4, 0, 0);
  FrameRef first = pool.lend(2, {});
  FrameRef second = pool.lend(0, {});
  expect_states(pool, 2, 2, 0);
  first.reset();
  expect_states(pool, 2, 1, 1);
  EXPECT_EQ(pool.take_returned(), 2);
  expect_states(pool, 3, 1, 0);
  EXPECT_EQ(pool.take_returned(), std::nullopt);
  second.reset();
  EXPECT_EQ(pool.take_returned(), 0);
  expect_states(pool, 4, 0, 0);
}

TEST(FramePool, AMovedReferenceGivesBackOnce) {
  FramePool pool(2);
  FrameRef first = pool.lend(0, {});
  FrameRef second = std::move(first);
  EXPECT_FALSE(first);  // NOLINT(bugprone-use-after-move): that it is empty is the point
  expect_states(pool, 1, 1, 0);
  second = pool.lend(1, {});  // what it held before goes back
  expect_states(pool, 0, 1, 1);
  second.reset();
  second.reset();
  expect_states(pool, 0, 0, 2);
}

TEST(FramePoolDeathTest, ABufferIsLentOnce) {
  FramePool pool(2);
  const FrameRef first = pool.lend(1, {});
  EXPECT_DEATH(static_cast<void>(pool.lend(1, {})), "does not hold");
  EXPECT_DEATH(static_cast<void>(pool.lend(2, {})), "does not hold");
}

TEST(FramePool, BuffersComeBackFromAnotherThread) {
  constexpr int kFrames = 1000;
  FramePool pool(3);
  Mailbox<FrameRef> mailbox;
  std::thread consumer([&] {
    for (int i = 0; i < kFrames; ++i) {
      EXPECT_TRUE(mailbox.take(std::chrono::seconds(5)).has_value());  // dropped at once
    }
  });
  for (int sent = 0; sent < kFrames; ++sent) {
    const int index = sent < pool.size() ? sent : pool.take_returned().value_or(-1);
    ASSERT_GE(index, 0) << "a buffer went missing";
    mailbox.put(pool.lend(index, {}));
    while (pool.count(State::kLent) > 0) std::this_thread::yield();
  }
  consumer.join();
  expect_states(pool, 0, 0, 3);
  EXPECT_EQ(mailbox.dropped(), 0U);
}

TEST(Mailbox, TheNewestWinsAndTheOthersAreCounted) {
  Mailbox<int> mailbox;
  mailbox.put(1);
  mailbox.put(2);
  mailbox.put(3);
  EXPECT_EQ(mailbox.take(std::chrono::seconds(0)), 3);
  EXPECT_EQ(mailbox.dropped(), 2U);
  EXPECT_EQ(mailbox.take(std::chrono::milliseconds(1)), std::nullopt);
  mailbox.put(4);
  mailbox.clear();
  mailbox.clear();
  EXPECT_EQ(mailbox.dropped(), 3U);
}

TEST(Mailbox, ReplacedAndClearedItemsAreDestroyed) {
  Mailbox<std::shared_ptr<int>> mailbox;
  const auto item = std::make_shared<int>(1);
  mailbox.put(item);
  mailbox.put(nullptr);
  EXPECT_EQ(item.use_count(), 1);
  mailbox.put(item);
  mailbox.clear();
  EXPECT_EQ(item.use_count(), 1);
}

TEST(Mailbox, ClosingWakesAWaitingThread) {
  Mailbox<int> mailbox;
  std::thread waiting([&] { EXPECT_EQ(mailbox.take(std::chrono::seconds(60)), std::nullopt); });
  mailbox.close();
  waiting.join();
}

TEST(SpscRing, GivesBackInOrderAndRefusesWhenFull) {
  SpscRing<int, 3> ring;
  EXPECT_EQ(ring.pop(), std::nullopt);
  for (int round = 0; round < 5; ++round) {
    for (int i = 0; i < 3; ++i) EXPECT_TRUE(ring.push(10 * round + i));
    EXPECT_FALSE(ring.push(99));
    for (int i = 0; i < 3; ++i) EXPECT_EQ(ring.pop(), 10 * round + i);
  }
}

TEST(SpscRing, CarriesEverythingBetweenTwoThreads) {
  constexpr int kItems = 100'000;
  SpscRing<int, 64> ring;
  std::thread producer([&] {
    for (int i = 0; i < kItems;) {
      if (ring.push(i)) ++i;
    }
  });
  for (int expected = 0; expected < kItems;) {
    const auto item = ring.pop();
    if (!item) continue;
    ASSERT_EQ(*item, expected);
    ++expected;
  }
  producer.join();
}

}  // namespace
}  // namespace lcdm
