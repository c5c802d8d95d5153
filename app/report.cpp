#include "app/report.h"

#include <cstdio>

#include "firmware/base/exit_code.h"

namespace lcdm {

int report(const Status& status) {
  std::fprintf(stderr, "lcdm: %s\n", status.text());
  return exit_code_of(status);
}

}  // namespace lcdm
