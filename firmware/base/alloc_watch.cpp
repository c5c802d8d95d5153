#include "firmware/base/alloc_watch.h"

#include <atomic>
#include <cstdlib>
#include <cstring>
#include <pthread.h>
#include <unistd.h>

namespace lcdm::alloc_watch {
namespace {

thread_local bool t_sealed = false;
thread_local std::uint64_t t_allocations = 0;
std::atomic<std::uint64_t> g_process_allocations{0};
std::atomic<std::uint64_t> g_sealed_allocations{0};
std::atomic<bool> g_abort{false};
std::atomic<bool> g_hooked{false};

void write_text(const char* text) {
  [[maybe_unused]] const ssize_t written = write(STDERR_FILENO, text, std::strlen(text));
}

[[noreturn]] void abort_sealed() {
  char name[16] = "?";
  pthread_getname_np(pthread_self(), name, sizeof(name));
  write_text("allocation in the sealed thread ");
  write_text(name);
  write_text("\n");
  std::abort();
}

}  // namespace

bool hooked() { return g_hooked.load(std::memory_order_relaxed); }
std::uint64_t thread_allocations() { return t_allocations; }
std::uint64_t process_allocations() {
  return g_process_allocations.load(std::memory_order_relaxed);
}
void seal_thread() { t_sealed = true; }
void unseal_thread() { t_sealed = false; }
std::uint64_t sealed_allocations() { return g_sealed_allocations.load(std::memory_order_relaxed); }
void abort_on_sealed_allocation() { g_abort.store(true, std::memory_order_relaxed); }
void note_hooked() noexcept { g_hooked.store(true, std::memory_order_relaxed); }

void note_allocation() noexcept {
  ++t_allocations;
  g_process_allocations.fetch_add(1, std::memory_order_relaxed);
  if (!t_sealed) return;
  g_sealed_allocations.fetch_add(1, std::memory_order_relaxed);
  if (g_abort.load(std::memory_order_relaxed)) {
    t_sealed = false;  // what abort itself allocates is not the fault
    abort_sealed();
  }
}

}  // namespace lcdm::alloc_watch
