#include "firmware/nn/kernels/peak.h"

#include <algorithm>

#include "firmware/base/os.h"

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "firmware/nn/kernels/peak.cpp"
#include "firmware/base/simd.h"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
#include "firmware/nn/kernels/math-inl.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

// Multiply-adds done; enough chains to hide the latency, few enough for 16 registers.
double spin(int rounds, float& sink) {
  constexpr int kChains = 12;
  const FullTag d;
  const FullVec factor = hn::Set(d, 0.999F);
  FullVec sum[kChains];
  for (int i = 0; i < kChains; ++i) sum[i] = hn::Set(d, static_cast<float>(i));
  for (int r = 0; r < rounds; ++r) {
    LCDM_UNROLL for (int i = 0; i < kChains; ++i) sum[i] = hn::MulAdd(sum[i], factor, factor);
  }
  for (int i = 0; i < kChains; ++i) sink += hn::GetLane(sum[i]);
  return static_cast<double>(rounds) * kChains * static_cast<double>(hn::Lanes(d));
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm::kernels {

HWY_EXPORT(spin);

double peak_gmacs(int runs) {
  constexpr int kRounds = 100'000;
  double best = 0;
  volatile float kept = 0;
  for (int i = 0; i < runs; ++i) {
    float sink = 0;
    const std::int64_t begin = os::thread_cpu_ns();
    const double macs = HWY_DYNAMIC_DISPATCH(spin)(kRounds, sink);
    const auto ns = static_cast<double>(os::thread_cpu_ns() - begin);
    kept = kept + sink;
    best = std::max(best, macs / ns);
  }
  return best;
}

double peak_copy(std::span<float> memory) {
  const std::span<float> to = memory.last(memory.size() / 2);
  const std::int64_t begin = os::thread_cpu_ns();
  std::copy_n(memory.begin(), to.size(), to.begin());
  const auto ns = static_cast<double>(os::thread_cpu_ns() - begin);
  return 2 * static_cast<double>(to.size_bytes()) / ns;
}

}  // namespace lcdm::kernels
#endif  // HWY_ONCE
