#include "firmware/base/os.h"

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <fcntl.h>
#include <fstream>
#include <pthread.h>
#include <sched.h>
#include <string>
#include <sys/auxv.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#ifdef __SANITIZE_ADDRESS__
#include <sanitizer/asan_interface.h>
#endif

namespace lcdm::os {
namespace {

std::int64_t clock_ns(clockid_t clock) {
  timespec now{};
  clock_gettime(clock, &now);
  return static_cast<std::int64_t>(now.tv_sec) * 1'000'000'000 + now.tv_nsec;
}

}  // namespace

std::int64_t monotonic_ns() { return clock_ns(CLOCK_MONOTONIC); }

std::int64_t unix_offset_ns() { return clock_ns(CLOCK_REALTIME) - clock_ns(CLOCK_MONOTONIC); }

std::int64_t thread_cpu_ns() { return clock_ns(CLOCK_THREAD_CPUTIME_ID); }

void set_thread_name(const char* name) {
  char cut[16];
  std::snprintf(cut, sizeof(cut), "%s", name);
  pthread_setname_np(pthread_self(), cut);
}

void lower_thread_priority(int steps) {
  const auto thread = static_cast<id_t>(syscall(SYS_gettid));
  setpriority(PRIO_PROCESS, thread, getpriority(PRIO_PROCESS, thread) + steps);
}

void pin_thread(int index) {
  cpu_set_t allowed;
  CPU_ZERO(&allowed);
  if (sched_getaffinity(0, sizeof(allowed), &allowed) != 0) return;
  int left = index % std::max(1, CPU_COUNT(&allowed));
  for (std::size_t processor = 0; processor < CPU_SETSIZE; ++processor) {
    if (!CPU_ISSET(processor, &allowed) || left-- > 0) continue;
    cpu_set_t one;
    CPU_ZERO(&one);
    CPU_SET(processor, &one);
    sched_setaffinity(0, sizeof(one), &one);
    return;
  }
}

namespace {

// `bytes`, a multiple of a page's, from a multiple of `alignment`: more is mapped and given back.
std::byte* map_aligned(std::size_t bytes, std::size_t alignment) {
  void* mapped =
      mmap(nullptr, bytes + alignment, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (mapped == MAP_FAILED) return nullptr;
  auto* begin = static_cast<std::byte*>(mapped);
  const std::size_t before =
      (alignment - std::bit_cast<std::uintptr_t>(begin) % alignment) % alignment;
  if (before > 0) munmap(begin, before);
  munmap(begin + before + bytes, alignment - before);
  return begin + before;
}

std::size_t rounded_up(std::size_t bytes, std::size_t step) {
  return (bytes + step - 1) / step * step;
}

}  // namespace

Result<std::byte*> allocate_pages(std::size_t bytes) {
  const auto page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
  std::byte* memory =
      map_aligned(rounded_up(std::max<std::size_t>(bytes, 1), page), kHugePageBytes);
  if (memory == nullptr) {
    return Status::error(StatusCode::kOutOfMemory,
                         "cannot reserve %zu bytes: free memory or choose a smaller input size",
                         bytes);
  }
  madvise(memory, bytes, MADV_HUGEPAGE);  // best effort
  std::memset(memory, 0, bytes);          // touches every page: no faults later
  return memory;
}

// What is mapped there next must not find it forbidden.
void free_pages(std::byte* memory, std::size_t bytes) noexcept {
  allow_memory(memory, bytes);
  if (memory != nullptr) munmap(memory, bytes);
}

#ifdef __SANITIZE_ADDRESS__
void forbid_memory(const std::byte* memory, std::size_t bytes) noexcept {
  ASAN_POISON_MEMORY_REGION(memory, bytes);
}
void allow_memory(const std::byte* memory, std::size_t bytes) noexcept {
  ASAN_UNPOISON_MEMORY_REGION(memory, bytes);
}
#else
void forbid_memory(const std::byte*, std::size_t) noexcept {}
void allow_memory(const std::byte*, std::size_t) noexcept {}
#endif

Status lock_pages(std::byte* memory, std::size_t bytes) {
  if (mlock(memory, bytes) == 0) return Status::ok();
  return Status::system(errno, "cannot lock %zu bytes in memory (raise LimitMEMLOCK=)", bytes);
}

// "always [madvise] never": the one in brackets is in force.
bool gives_huge_pages(const std::string& sysfs) {
  std::ifstream file(sysfs + "/kernel/mm/transparent_hugepage/enabled");
  std::string choices;
  return std::getline(file, choices) && choices.find("[never]") == std::string::npos;
}

bool has_dot_product() {
#if defined(__aarch64__)
  return (getauxval(AT_HWCAP) & HWCAP_ASIMDDP) != 0;
#else
  return false;
#endif
}

bool has_half_arithmetic() {
#if defined(__aarch64__)
  return (getauxval(AT_HWCAP) & HWCAP_ASIMDHP) != 0;
#else
  return false;
#endif
}

int processor_count() {
  cpu_set_t set;
  CPU_ZERO(&set);
  if (sched_getaffinity(0, sizeof(set), &set) != 0) return 1;
  return CPU_COUNT(&set) > 0 ? CPU_COUNT(&set) : 1;
}

std::size_t peak_rss_bytes() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<std::size_t>(usage.ru_maxrss) * 1024;
}

std::int64_t page_faults() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return usage.ru_minflt + usage.ru_majflt;
}

bool sync_file(std::FILE* file) noexcept {
  return std::fflush(file) == 0 && fsync(fileno(file)) == 0;
}

void sync_folder(const char* folder) noexcept {
  const int descriptor = open(folder[0] == 0 ? "." : folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (descriptor < 0) return;
  fsync(descriptor);
  close(descriptor);
}

}  // namespace lcdm::os
