// Linked into a test program it makes LCDM_ISA count there as in `lcdm`; where this processor has
// no such instruction set the program ends with 77, which ctest calls skipped.
#include <cstdio>
#include <cstdlib>

#include "firmware/nn/kernels/isa.h"

namespace {

[[maybe_unused]] const bool forced = [] {
  const lcdm::Status status = lcdm::kernels::force_isa_of_environment();
  if (!status) {
    std::printf("skipped: %s\n", status.text());
    std::exit(77);  // NOLINT(concurrency-mt-unsafe): no threads yet
  }
  return true;
}();

}  // namespace
