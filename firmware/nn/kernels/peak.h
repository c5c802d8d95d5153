// The machine's own limits, which the profile measures the kernels by.
#pragma once

#include <span>

namespace lcdm::kernels {

// fp32 multiply-adds a second of one thread here and now, in 1e9 (two FLOP each): the best of
// `runs` runs, a fraction of a millisecond each, of independent vector operations in registers.
double peak_gmacs(int runs = 20);

// Bytes read and written a nanosecond where the first half of `memory` is copied to the second.
double peak_copy(std::span<float> memory);

}  // namespace lcdm::kernels
