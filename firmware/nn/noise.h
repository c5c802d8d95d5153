// The sampler's start: Gaussian noise that is a function of its seed and nothing else.
#pragma once

#include <cstdint>
#include <span>

namespace lcdm {

// Fills `out` with independent values of N(0, 1). Counter-based: value i depends on `seed` and i
// alone, so a longer map begins with the shorter one, and no state is kept. Box-Muller in double on
// splitmix64 outputs (Steele, Lea, Flood 2014): values 2j and 2j+1 are the cosine and sine branch
// of pair j. The trainer and the engine must use this same function.
void fill_gaussian(std::uint64_t seed, std::span<float> out);

}  // namespace lcdm
