#include "firmware/base/status.h"

#include <cstdio>
#include <cstdlib>
#include <cstring>

#include "firmware/base/printable.h"

namespace lcdm {
namespace {

// What a file's name or contents put into a text must not steer the terminal that shows it.
void hide_controls_in(char* text) { hide_controls({text, std::strlen(text)}); }

}  // namespace

void check_failed(const char* condition, const char* file, int line) noexcept {
  std::fprintf(stderr, "bug: %s does not hold at %s:%d\n", condition, file, line);
  std::abort();
}

Status Status::error(StatusCode code, const char* format, ...) {
  LCDM_CHECK(code != StatusCode::kOk);
  Status status;
  status.code_ = code;
  va_list arguments;
  va_start(arguments, format);
  // clang-analyzer 14 does not see that va_start initialised it.
  // NOLINTNEXTLINE(clang-analyzer-valist.Uninitialized)
  std::vsnprintf(status.text_, sizeof(status.text_), format, arguments);
  va_end(arguments);
  hide_controls_in(status.text_);
  return status;
}

Status Status::system(int sys_errno, const char* format, ...) {
  Status status;
  status.code_ = StatusCode::kIoError;
  status.sys_errno_ = sys_errno;
  va_list arguments;
  va_start(arguments, format);
  // clang-analyzer 14 does not see that va_start initialised it.
  // NOLINTNEXTLINE(clang-analyzer-valist.Uninitialized)
  std::vsnprintf(status.text_, sizeof(status.text_), format, arguments);
  va_end(arguments);
  const std::size_t used = std::strlen(status.text_);
  // strerrordesc_np would be thread-safe without a buffer, but is glibc 2.32+ only by name; the
  // GNU strerror_r may ignore the buffer and return a static text.
  char buffer[96];
  const char* meaning = strerror_r(sys_errno, buffer, sizeof(buffer));
  std::snprintf(status.text_ + used, sizeof(status.text_) - used, ": %s", meaning);
  hide_controls_in(status.text_);
  return status;
}

const char* to_string(StatusCode code) {
  switch (code) {
    case StatusCode::kOk:
      return "ok";
    case StatusCode::kUsage:
      return "usage";
    case StatusCode::kInvalidInput:
      return "invalid input";
    case StatusCode::kNotFound:
      return "not found";
    case StatusCode::kUnsupported:
      return "unsupported";
    case StatusCode::kCorrupt:
      return "corrupt";
    case StatusCode::kTimeout:
      return "time-out";
    case StatusCode::kUnavailable:
      return "unavailable";
    case StatusCode::kDeviceGone:
      return "device gone";
    case StatusCode::kEndOfStream:
      return "end of stream";
    case StatusCode::kIoError:
      return "I/O error";
    case StatusCode::kOutOfMemory:
      return "out of memory";
  }
  return "unknown";
}

}  // namespace lcdm
