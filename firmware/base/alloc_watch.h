// Who may allocate: a thread seals itself when its steady state begins, and from then on an
// allocation on it is counted, and in test programs fatal. The hooks in alloc_hooks.cpp are
// linked into programs that want this; without them the counters stay at zero.
#pragma once

#include <cstdint>

namespace lcdm::alloc_watch {

// True when this program carries the hooks (not under sanitizers, which bring their own malloc).
bool hooked();

// Allocations made by the calling thread since it began.
std::uint64_t thread_allocations();

// Allocations made by all threads since the program began.
std::uint64_t process_allocations();

// Marks the calling thread's steady state. Reversible, for orderly shutdown.
void seal_thread();
void unseal_thread();

// Allocations made by sealed threads since the program began: 0 is the promise.
std::uint64_t sealed_allocations();

// From now on an allocation in a sealed thread prints the thread's name and aborts (for tests).
void abort_on_sealed_allocation();

// Called by the hooks on every allocation.
void note_allocation() noexcept;
void note_hooked() noexcept;

}  // namespace lcdm::alloc_watch
