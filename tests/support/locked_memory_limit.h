// What an account without privileges may lock in memory.
#pragma once

#include <sys/resource.h>
#include <unistd.h>

#include "firmware/base/check.h"

namespace lcdm::test {

// For the rest of the process, whose first user loses its rights: in a death test only.
inline void limit_locked_memory(rlim_t bytes) {
  const rlimit limit{bytes, bytes};
  LCDM_CHECK(setrlimit(RLIMIT_MEMLOCK, &limit) == 0);
  constexpr uid_t kNobody = 65534;
  if (geteuid() == 0) LCDM_CHECK(seteuid(kNobody) == 0);
}

}  // namespace lcdm::test
