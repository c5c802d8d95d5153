#include "firmware/nn/worker_pool.h"

#include <algorithm>
#include <cstdio>

#include "firmware/base/alloc_watch.h"
#include "firmware/base/check.h"
#include "firmware/base/os.h"

namespace lcdm {
namespace {

// Rounds follow each other within microseconds: look this often before going to sleep.
constexpr int kSpins = 2000;

void pause_briefly() {
#if defined(__x86_64__) || defined(__i386__)
  __builtin_ia32_pause();
#elif defined(__aarch64__) || defined(__arm__)
  asm volatile("yield");
#endif
}

// Returns when `value` is no longer `old`; spins, then sleeps in the kernel.
template <typename T>
void wait_for_change(const std::atomic<T>& value, T old) {
  for (int i = 0; i < kSpins; ++i) {
    if (value.load(std::memory_order_acquire) != old) return;
    pause_briefly();
  }
  value.wait(old, std::memory_order_acquire);
}

}  // namespace

WorkerPool::WorkerPool(int workers, bool pinned) : workers_(workers), pinned_(pinned) {
  LCDM_CHECK(workers >= 1);
  threads_.reserve(static_cast<std::size_t>(workers) - 1);
  try {
    for (int i = 1; i < workers; ++i) threads_.emplace_back([this, i] { work(i); });
  } catch (...) {  // no more threads for this process: those that began must end before we say so
    stop();
    throw;
  }
}

WorkerPool::~WorkerPool() { stop(); }

void WorkerPool::stop() {
  stop_.store(true, std::memory_order_relaxed);
  round_.fetch_add(1, std::memory_order_release);
  round_.notify_all();
  for (std::thread& thread : threads_) thread.join();
}

void WorkerPool::run_erased(Entry entry, void* context) noexcept {
  if (workers_ == 1) {
    entry(context, 0);
    return;
  }
  entry_ = entry;
  context_ = context;
  busy_.store(workers_ - 1, std::memory_order_relaxed);
  round_.fetch_add(1, std::memory_order_release);
  round_.notify_all();
  entry(context, 0);
  for (int left = busy_.load(std::memory_order_acquire); left != 0;
       left = busy_.load(std::memory_order_acquire)) {
    wait_for_change(busy_, left);
  }
}

void WorkerPool::work(int worker) noexcept {
  char name[16];
  std::snprintf(name, sizeof(name), "infer-%d", worker);
  os::set_thread_name(name);
  if (pinned_) os::pin_thread(worker);
  alloc_watch::seal_thread();
  // Rounds begin only after the constructor, at 0; none is missed, run() waits for everyone.
  for (std::uint32_t seen = 0;; ++seen) {
    wait_for_change(round_, seen);
    if (stop_.load(std::memory_order_relaxed)) return;
    entry_(context_, worker);
    if (busy_.fetch_sub(1, std::memory_order_acq_rel) == 1) busy_.notify_one();
  }
}

Slice slice_of(int count, int index, int parts, int grain) {
  const std::int64_t grains = (count + grain - 1) / grain;
  const auto boundary = [&](int i) {
    return static_cast<int>(std::min<std::int64_t>(count, grains * i / parts * grain));
  };
  return {boundary(index), boundary(index + 1)};
}

}  // namespace lcdm
