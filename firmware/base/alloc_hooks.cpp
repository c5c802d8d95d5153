// malloc and friends, counted (see alloc_watch.h). Linked as an object file into the programs that
// promise not to allocate; sanitizer builds leave it out, they bring their own malloc.
#include <cerrno>
#include <cstddef>

#include "firmware/base/alloc_watch.h"

extern "C" {

void* __libc_malloc(std::size_t);                 // NOLINT
void* __libc_calloc(std::size_t, std::size_t);    // NOLINT
void* __libc_realloc(void*, std::size_t);         // NOLINT
void* __libc_memalign(std::size_t, std::size_t);  // NOLINT

void* malloc(std::size_t bytes) {
  lcdm::alloc_watch::note_allocation();
  return __libc_malloc(bytes);
}

void* calloc(std::size_t count, std::size_t bytes) {
  lcdm::alloc_watch::note_allocation();
  return __libc_calloc(count, bytes);
}

void* realloc(void* memory, std::size_t bytes) {
  lcdm::alloc_watch::note_allocation();
  return __libc_realloc(memory, bytes);
}

void* memalign(std::size_t alignment, std::size_t bytes) {
  lcdm::alloc_watch::note_allocation();
  return __libc_memalign(alignment, bytes);
}

void* aligned_alloc(std::size_t alignment, std::size_t bytes) { return memalign(alignment, bytes); }

int posix_memalign(void** memory, std::size_t alignment, std::size_t bytes) {
  *memory = memalign(alignment, bytes);
  return *memory == nullptr && bytes != 0 ? ENOMEM : 0;
}

}  // extern "C"

namespace {
const bool g_installed = (lcdm::alloc_watch::note_hooked(), true);
}
