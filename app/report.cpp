#include "app/report.h"

#include <cstdio>

#include "app/exit_code.h"

namespace lcdm {

int report_unusable(const Status& status) {
  std::fprintf(stderr, "lcdm: %s\n", status.text());
  return kExitConfig;
}

int report_failure(const Status& status) {
  std::fprintf(stderr, "lcdm: %s\n", status.text());
  return status.code() == StatusCode::kInvalidInput ? kExitConfig : kExitFailure;
}

}  // namespace lcdm
