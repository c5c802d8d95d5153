// Asserts that stay in release builds: a failed one is a bug of ours, never somebody's input.
#pragma once

namespace lcdm {

// Prints place and condition to standard error and aborts; the service manager restarts us.
[[noreturn]] void check_failed(const char* condition, const char* file, int line) noexcept;

}  // namespace lcdm

#define LCDM_CHECK(condition) \
  ((condition) ? static_cast<void>(0) : ::lcdm::check_failed(#condition, __FILE__, __LINE__))
