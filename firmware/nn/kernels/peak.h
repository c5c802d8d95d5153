// The processor's own limit, which the profile measures the kernels by.
#pragma once

namespace lcdm::kernels {

// fp32 multiply-adds a second of one thread here and now, in 1e9 (two FLOP each): the best of
// several runs of independent vector operations in registers, some milliseconds in all.
double peak_gmacs();

}  // namespace lcdm::kernels
