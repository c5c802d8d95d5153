#include "firmware/nn/noise.h"

#include <cmath>
#include <cstddef>
#include <numbers>

namespace lcdm {
namespace {

// The `index`-th output of splitmix64 started at `seed`.
std::uint64_t splitmix64(std::uint64_t seed, std::uint64_t index) {
  std::uint64_t z = seed + (index + 1) * 0x9E3779B97F4A7C15ULL;
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ULL;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBULL;
  return z ^ (z >> 31);
}

// In (0, 1): 53 bits, the half keeps log() away from zero.
double uniform(std::uint64_t seed, std::uint64_t index) {
  return (static_cast<double>(splitmix64(seed, index) >> 11) + 0.5) * 0x1.0p-53;
}

}  // namespace

void fill_gaussian(std::uint64_t seed, std::span<float> out) {
  for (std::size_t i = 0; i < out.size(); i += 2) {
    const double radius = std::sqrt(-2.0 * std::log(uniform(seed, i)));
    const double angle = 2.0 * std::numbers::pi * uniform(seed, i + 1);
    out[i] = static_cast<float>(radius * std::cos(angle));
    if (i + 1 < out.size()) out[i + 1] = static_cast<float>(radius * std::sin(angle));
  }
}

}  // namespace lcdm
