// Running a check once for every instruction set the kernels are compiled for.
#pragma once

// clang-format off
#include "firmware/nn/kernels/simd.h"
#include "hwy/targets.h"
// clang-format on

#include <gtest/gtest.h>
#include <random>
#include <vector>

namespace lcdm::test {

// Calls check() with the kernels forced to each instruction set this processor has in turn, then
// lets them choose again.
template <typename Check>
void for_each_isa(Check&& check) {
  for (const auto target : hwy::SupportedAndGeneratedTargets()) {
    SCOPED_TRACE(hwy::TargetName(target));
    hwy::SetSupportedTargetsForTest(target);
    hwy::GetChosenTarget().DeInit();
    check();
  }
  hwy::SetSupportedTargetsForTest(0);
  hwy::GetChosenTarget().DeInit();
}

// The same values on every run.
class Random {
 public:
  explicit Random(unsigned seed) : engine_(seed) {}
  float real(float low = -1, float high = 1) {
    return std::uniform_real_distribution<float>(low, high)(engine_);
  }
  int whole(int low, int high) { return std::uniform_int_distribution<int>(low, high)(engine_); }
  std::vector<float> reals(std::size_t count, float low = -1, float high = 1) {
    std::vector<float> out(count);
    for (float& v : out) v = real(low, high);
    return out;
  }

 private:
  std::mt19937 engine_;
};

}  // namespace lcdm::test
