#include "app/finding.h"

#include <utility>

namespace lcdm {

const char* to_string(Severity severity) {
  switch (severity) {
    case Severity::kOk:
      return "ok";
    case Severity::kWarning:
      return "warning";
    case Severity::kFault:
      return "fault";
  }
  return "unknown";
}

Finding well(const char* subject, std::string text) {
  return {Severity::kOk, subject, std::move(text)};
}

Finding warning(const char* subject, std::string text) {
  return {Severity::kWarning, subject, std::move(text)};
}

Finding fault(const char* subject, std::string text) {
  return {Severity::kFault, subject, std::move(text)};
}

}  // namespace lcdm
