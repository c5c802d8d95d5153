// Running a check once for every instruction set the kernels are compiled for.
#pragma once

// clang-format off
#include "firmware/base/simd.h"
#include "hwy/targets.h"
// clang-format on

#include <cstdio>
#include <gtest/gtest.h>
#include <random>
#include <set>
#include <string>
#include <vector>

#include "firmware/nn/kernels/matrix.h"
#include "firmware/nn/network.h"

namespace lcdm::test {

constexpr Precision kNarrow[] = {Precision::kFloat16, Precision::kBfloat16, Precision::kInt8};

// The narrow precisions whose products this processor makes with the chosen instruction set, those
// that are put together slowly in brackets.
inline std::string narrow_precisions() {
  std::string names;
  for (const Precision precision : kNarrow) {
    const kernels::Support support = kernels::support_of(precision);
    if (support == kernels::Support::kNone) continue;
    const std::string name = to_string(precision);
    names += support == kernels::Support::kNative ? " " + name : " (" + name + ")";
  }
  return names;
}

// Notes what a test runs with: what this processor lacks is not tested here, and nothing fails. In
// the test's report, and once in the program's output.
inline void note_isa(const char* name) {
  static std::set<std::string> printed;
  const std::string precisions = narrow_precisions();
  testing::Test::RecordProperty(name, "fp32" + precisions);
  if (printed.insert(name).second)
    std::printf("[ kernels  ] %s: fp32%s\n", name, precisions.c_str());
}

// Calls check() with the kernels forced to each instruction set this processor has in turn, then
// lets them choose again.
template <typename Check>
void for_each_isa(Check&& check) {
  for (const auto target : hwy::SupportedAndGeneratedTargets()) {
    SCOPED_TRACE(hwy::TargetName(target));
    hwy::SetSupportedTargetsForTest(target);
    hwy::GetChosenTarget().DeInit();
    note_isa(hwy::TargetName(target));
    check();
  }
  hwy::SetSupportedTargetsForTest(0);
  hwy::GetChosenTarget().DeInit();
}

// Calls check(precision) for every narrow one that each instruction set has.
template <typename Check>
void for_each_narrow(Check&& check) {
  for_each_isa([&] {
    for (const Precision precision : kNarrow) {
      if (kernels::support_of(precision) == kernels::Support::kNone) continue;
      SCOPED_TRACE(to_string(precision));
      check(precision);
    }
  });
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
