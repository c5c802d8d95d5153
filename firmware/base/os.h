// The only place in firmware/ that calls the operating system: clocks, pages, threads,
// files where the standard library has no way.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <string>

#include "firmware/base/status.h"

namespace lcdm::os {

// CLOCK_MONOTONIC, nanoseconds. The clock of every frame stamp and age.
std::int64_t monotonic_ns();

// CLOCK_REALTIME minus CLOCK_MONOTONIC, nanoseconds: add it to a frame stamp to get Unix time.
std::int64_t unix_offset_ns();

// CPU time of the calling thread, nanoseconds.
std::int64_t thread_cpu_ns();

// Names the calling thread (cut to 15 characters) as seen in top and gdb.
void set_thread_name(const char* name);

// Raises the calling thread's nice value by `steps`, so that others go first. Best effort.
void lower_thread_priority(int steps);

// Keeps the calling thread on one processor: number `index` (from 0, and from the start again) of
// those that it may run on. Best effort.
void pin_thread(int index);

// Of x86, and of Arm where a page has 4 KB.
constexpr std::size_t kHugePageBytes = std::size_t{2} << 20;
// Zeroed memory from such a page's beginning on, every page touched, in huge pages where the kernel
// gives them: fewer misses of the address cache. Owned by the caller: give it to free_pages.
Result<std::byte*> allocate_pages(std::size_t bytes);
void free_pages(std::byte* memory, std::size_t bytes) noexcept;

// In programs with AddressSanitizer pieces of one block lie so far apart, and what no piece has is
// forbidden: it reports who runs over a piece's end. Elsewhere they touch, and nothing is
// forbidden.
#ifdef __SANITIZE_ADDRESS__
constexpr std::size_t kGuardBytes = 1024;
#else
constexpr std::size_t kGuardBytes = 0;
#endif
void forbid_memory(const std::byte* memory, std::size_t bytes) noexcept;
void allow_memory(const std::byte* memory, std::size_t bytes) noexcept;

// Whether the kernel gives huge pages to those who ask. `sysfs`: where it is mounted.
bool gives_huge_pages(const std::string& sysfs = "/sys");

// Whether this is an Arm processor with dot products of 8-bit integers (Armv8.2 DotProd).
bool has_dot_product();
// Whether it is one with arithmetic of half-precision vectors (Armv8.2 FP16).
bool has_half_arithmetic();

// Locks memory against swapping. Fails where RLIMIT_MEMLOCK is too small.
Status lock_pages(std::byte* memory, std::size_t bytes);

// Number of processors the calling thread may run on, at least 1.
int processor_count();

// Largest resident set of this process so far, bytes.
std::size_t peak_rss_bytes();

// Minor plus major page faults of all threads of this process so far.
std::int64_t page_faults();

// Makes what was written to a file last through a power cut. False: it could not, errno says why.
bool sync_file(std::FILE* file) noexcept;

// Makes the names in a folder ("" is the present one) last through a power cut, where its file
// system can.
void sync_folder(const char* folder) noexcept;

}  // namespace lcdm::os
