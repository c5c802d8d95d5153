// What the doctor says of one thing.
#pragma once

#include <cstdint>
#include <string>

namespace lcdm {

enum class Severity : std::uint8_t {
  kOk,
  kWarning,  // depth comes, but less, or less safely
  kFault,    // no depth until it is mended
};

const char* to_string(Severity severity);

struct Finding {
  Severity severity = Severity::kOk;
  std::string subject;  // what was looked at, one word
  std::string text;     // what was found; where it is not well, with its cure
};

Finding well(const char* subject, std::string text);
Finding warning(const char* subject, std::string text);
Finding fault(const char* subject, std::string text);

}  // namespace lcdm
