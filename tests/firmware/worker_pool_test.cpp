// The team of inference threads.
#include "firmware/nn/worker_pool.h"

#include <fstream>
#include <gtest/gtest.h>
#include <numeric>
#include <sched.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <system_error>
#include <unistd.h>

#include "firmware/base/os.h"

namespace lcdm {
namespace {

TEST(WorkerPool, EveryWorkerDoesItsPartOnceARound) {
  for (const int workers : {1, 2, 3, 5}) {
    WorkerPool pool(workers);
    std::vector<int> done(static_cast<std::size_t>(workers));
    for (int round = 1; round <= 2000; ++round) {
      pool.run([&](int worker) { ++done[static_cast<std::size_t>(worker)]; });
      // run() returned: all parts of this round are visible, none of the next has begun.
      for (const int count : done) ASSERT_EQ(count, round);
    }
  }
}

TEST(WorkerPool, WakesFromSleep) {
  WorkerPool pool(2);
  int rounds = 0;  // touched by worker 1 alone
  for (int i = 0; i < 5; ++i) {
    const std::int64_t until = os::monotonic_ns() + 3'000'000;  // long after the spinning ends
    while (os::monotonic_ns() < until) std::this_thread::yield();
    pool.run([&](int worker) {
      if (worker == 1) ++rounds;
    });
  }
  EXPECT_EQ(rounds, 5);
}

TEST(WorkerPool, TheCallerIsWorkerZero) {
  WorkerPool pool(3);
  const auto caller = std::this_thread::get_id();
  std::vector<std::thread::id> ids(3);
  pool.run([&](int worker) { ids[static_cast<std::size_t>(worker)] = std::this_thread::get_id(); });
  EXPECT_EQ(ids[0], caller);
  EXPECT_NE(ids[1], caller);
  EXPECT_NE(ids[1], ids[2]);
}

#ifndef LCDM_SANITIZED  // their own maps do not fit either
// As where ulimit -u or TasksMax= ends in the midst of a team: its first threads must not be left.
void run_short_of_threads() {
  std::ifstream statm("/proc/self/statm");
  rlim_t pages = 0;
  statm >> pages;
  const rlim_t room = pages * static_cast<rlim_t>(sysconf(_SC_PAGESIZE)) + (rlim_t{40} << 20);
  const rlimit limit = {room, room};  // of stacks of 8 MB each, among all else
  setrlimit(RLIMIT_AS, &limit);
  try {
    WorkerPool pool(64);
  } catch (const std::system_error&) {
    _exit(0);
  }
  _exit(1);
}

// QEMU's user mode does not heed the limit.
bool address_space_can_be_limited() {
  constexpr std::size_t kSize = 1 << 20;
  rlimit before{};
  getrlimit(RLIMIT_AS, &before);
  const rlimit full = {kSize, before.rlim_max};
  setrlimit(RLIMIT_AS, &full);
  void* more = mmap(nullptr, kSize, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  setrlimit(RLIMIT_AS, &before);
  if (more == MAP_FAILED) return true;
  munmap(more, kSize);
  return false;
}

TEST(WorkerPoolDeathTest, SaysThatThereAreNoMoreThreads) {
  if (!address_space_can_be_limited()) GTEST_SKIP() << "RLIMIT_AS is not heeded here";
  EXPECT_EXIT(run_short_of_threads(), testing::ExitedWithCode(0), "");
}
#endif

TEST(WorkerPool, PinnedWorkersStayOnAProcessorOfTheirOwn) {
  const int processors = os::processor_count();
  WorkerPool pool(3, true);
  std::vector<int> allowed(3);
  std::vector<int> at(3);
  pool.run([&](int worker) {
    allowed[static_cast<std::size_t>(worker)] = os::processor_count();
    at[static_cast<std::size_t>(worker)] = sched_getcpu();
  });
  EXPECT_EQ(allowed, (std::vector<int>{processors, 1, 1})) << "the caller's is not ours to move";
  EXPECT_TRUE(processors == 1 || at[1] != at[2]);
}

TEST(SliceOf, PartsCoverEverythingOnceAtGrains) {
  for (int count = 0; count < 50; ++count) {
    for (int parts = 1; parts < 7; ++parts) {
      for (const int grain : {1, 4, 8}) {
        int next = 0;
        for (int i = 0; i < parts; ++i) {
          const Slice slice = slice_of(count, i, parts, grain);
          ASSERT_EQ(slice.begin, next);
          ASSERT_LE(slice.begin, slice.end);
          ASSERT_TRUE(slice.end == count || slice.end % grain == 0);
          next = slice.end;
        }
        ASSERT_EQ(next, count);
      }
    }
  }
}

TEST(SliceOf, PartsAreNearlyEqual) {
  for (int i = 0; i < 3; ++i) {
    const Slice slice = slice_of(100, i, 3);
    EXPECT_GE(slice.end - slice.begin, 33);
    EXPECT_LE(slice.end - slice.begin, 34);
  }
}

}  // namespace
}  // namespace lcdm
