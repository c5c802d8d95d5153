// Errors as values. Firmware and drivers return them, only app/ and model/ print them.
#pragma once

#include <cstdarg>
#include <cstdint>
#include <optional>
#include <utility>

#include "firmware/base/check.h"

namespace lcdm {

enum class StatusCode : std::uint8_t {
  kOk,
  kUsage,         // the command line: not understood, or it asks for what cannot be
  kInvalidInput,  // configuration, model, request: a retry cannot cure it
  kNotFound,      // a file or device that is not there
  kUnsupported,   // well-formed, but nothing here can handle it
  kCorrupt,       // bytes that break their own format
  kTimeout,       // nothing came in time: transient
  kUnavailable,   // busy, or not ready yet: transient
  kDeviceGone,    // the device left: close it and wait for it to come back
  kEndOfStream,   // a finite source has no more frames
  kIoError,       // the operating system refused; see sys_errno()
  kOutOfMemory,
};

// The outcome of an operation: a code, the errno behind it, and one line for a person that says
// what, where and how to mend it. The text lives inside (no heap), cut at kMaxText - 1 bytes.
class [[nodiscard]] Status {
 public:
  static constexpr int kMaxText = 256;

  Status() = default;
  static Status ok() { return {}; }

  // printf-style; `code` must not be kOk.
  __attribute__((format(printf, 2, 3))) static Status error(StatusCode code, const char* format,
                                                            ...);
  // As error(kIoError), with errno's value kept and its meaning appended to the text.
  __attribute__((format(printf, 2, 3))) static Status system(int sys_errno, const char* format,
                                                             ...);

  bool is_ok() const { return code_ == StatusCode::kOk; }
  explicit operator bool() const { return is_ok(); }
  StatusCode code() const { return code_; }
  int sys_errno() const { return sys_errno_; }
  const char* text() const { return text_; }

 private:
  StatusCode code_ = StatusCode::kOk;
  int sys_errno_ = 0;
  char text_[kMaxText] = {};
};

const char* to_string(StatusCode code);

// A value, or the Status that says why there is none. Never holds an ok Status.
template <typename T>
class [[nodiscard]] Result {
 public:
  Result(T value) : value_(std::move(value)) {}                            // NOLINT
  Result(const Status& status) : status_(status) { LCDM_CHECK(!status); }  // NOLINT

  bool is_ok() const { return value_.has_value(); }
  explicit operator bool() const { return is_ok(); }
  const Status& status() const { return status_; }
  StatusCode code() const { return status_.code(); }

  T& value() {
    LCDM_CHECK(value_.has_value());
    return *value_;
  }
  const T& value() const {
    LCDM_CHECK(value_.has_value());
    return *value_;
  }
  T& operator*() { return value(); }
  const T& operator*() const { return value(); }
  T* operator->() { return &value(); }
  const T* operator->() const { return &value(); }

 private:
  std::optional<T> value_;
  Status status_;
};

}  // namespace lcdm

// Returns from the calling function when `expression` gives a Status that is not ok.
#define LCDM_RETURN_IF_ERROR(expression)                                             \
  do {                                                                               \
    if (::lcdm::Status lcdm_status = (expression); !lcdm_status) return lcdm_status; \
  } while (false)
