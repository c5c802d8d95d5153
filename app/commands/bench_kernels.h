// lcdm bench --kernels: each kernel of each instruction set beside the machine's own limits.
#pragma once

#include "firmware/base/status.h"

namespace lcdm {

// Runs every kernel at a layer of XS at 640x192, and the ways from a camera's bytes and to
// millimetres, with each instruction set of this processor and prints one table: milliseconds, and
// how much of them the multiply-adds (at the rate of that instruction set and precision) or the
// bytes to be moved would take by themselves. One thread. kOutOfMemory.
Status print_kernel_bench();

}  // namespace lcdm
