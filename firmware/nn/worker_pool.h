// A fixed team of threads that does one thing at a time together.
#pragma once

#include <atomic>
#include <cstdint>
#include <thread>
#include <type_traits>
#include <vector>

namespace lcdm {

// The thread that calls run() is worker 0; `workers - 1` more are started by the constructor and
// joined by the destructor. run() belongs to one thread at a time. Nothing allocates after
// construction, and the workers are sealed (base/alloc_watch.h).
class WorkerPool {
 public:
  // `pinned`: worker i stays on the i-th processor that this process may use; only worker 0, which
  // is somebody else's thread, is left as it is. std::system_error: no more threads for this
  // process.
  explicit WorkerPool(int workers, bool pinned = false);
  ~WorkerPool();
  WorkerPool(const WorkerPool&) = delete;
  WorkerPool& operator=(const WorkerPool&) = delete;

  int workers() const { return workers_; }

  // Calls task(worker) once for every worker, each on its own thread; returns when all are done.
  template <typename Task>
  void run(Task&& task) noexcept {
    using Plain = std::remove_reference_t<Task>;
    run_erased([](void* context, int worker) { (*static_cast<Plain*>(context))(worker); }, &task);
  }

 private:
  using Entry = void (*)(void* context, int worker);

  void run_erased(Entry entry, void* context) noexcept;
  void work(int worker) noexcept;
  void stop();

  int workers_;
  bool pinned_;
  Entry entry_ = nullptr;  // written before round_ moves on, read after
  void* context_ = nullptr;
  std::atomic<std::uint32_t> round_{0};
  std::atomic<int> busy_{0};
  std::atomic<bool> stop_{false};
  std::vector<std::thread> threads_;
};

// Part `index` of `count` items cut into `parts` nearly equal runs whose boundaries are multiples
// of `grain`. Depends on its arguments alone.
struct Slice {
  int begin = 0;
  int end = 0;
};
Slice slice_of(int count, int index, int parts, int grain = 1);

}  // namespace lcdm
