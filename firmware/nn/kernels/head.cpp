#include "firmware/nn/kernels/head.h"

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "firmware/nn/kernels/head.cpp"
#include "firmware/nn/kernels/simd.h"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
#include "firmware/nn/kernels/math-inl.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

// conv3x3 at one pixel, over kernel rows [ky_begin, ky_end) and columns [kx_begin, kx_end).
HWY_INLINE float convolve_pixel(const Update& u, int y, int x, int ky_begin, int ky_end,
                                int kx_begin, int kx_end) {
  const auto channels = static_cast<std::size_t>(u.channels);
  float sum = u.bias;
  for_channels(channels, [&](auto d, std::size_t c) HWY_ATTR {
    auto acc = hn::Zero(d);
    for (int ky = ky_begin; ky < ky_end; ++ky) {
      const float* row = u.h + static_cast<std::size_t>(y + ky - 1) * u.width * channels + c;
      const float* w = u.weights + static_cast<std::size_t>(ky) * 3 * channels + c;
      for (int kx = kx_begin; kx < kx_end; ++kx) {
        const float* in = row + static_cast<std::size_t>(x + kx - 1) * channels;
        acc = hn::MulAdd(hn::LoadU(d, in), hn::LoadU(d, w + kx * channels), acc);
      }
    }
    sum += hn::GetLane(hn::SumOfLanes(d, acc));
  });
  return sum;
}

void update(const Update& u, int begin, int end) {
  for (int y = begin; y < end; ++y) {
    const int ky_begin = y == 0 ? 1 : 0;
    const int ky_end = y == u.height - 1 ? 2 : 3;
    const std::size_t row = static_cast<std::size_t>(y) * u.width;
    for (int x = 0; x < u.width; ++x) {
      const bool inside = x > 0 && x < u.width - 1;
      const float out = inside ? convolve_pixel(u, y, x, ky_begin, ky_end, 0, 3)
                               : convolve_pixel(u, y, x, ky_begin, ky_end, x == 0 ? 1 : 0,
                                                x == u.width - 1 ? 2 : 3);
      u.next[row + x] = u.p * u.state[row + x] + u.q * out;
    }
  }
}

// 1 / (0.01 + 9.99 / (1 + e^-logit)) = (1 + e) / (10 + 0.01 e) with e = e^-logit.
void depth(const ToDepth& t, int begin, int end) {
  for_channels(static_cast<std::size_t>(end - begin), [&](auto d, std::size_t i) HWY_ATTR {
    const std::size_t at = static_cast<std::size_t>(begin) + i;
    const auto logit =
        hn::MulAdd(hn::LoadU(d, t.state + at), hn::Set(d, t.deviation), hn::Set(d, t.mean));
    const auto e = exp_approx(d, hn::Sub(hn::Zero(d), logit));
    const auto disparity = hn::MulAdd(e, hn::Set(d, 0.01F), hn::Set(d, 10.0F));
    const auto metres = hn::Div(hn::Add(hn::Set(d, 1.0F), e), disparity);
    hn::StoreU(hn::Mul(metres, hn::Set(d, t.scale)), d, t.metres + at);
  });
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm::kernels {

HWY_EXPORT(update);
HWY_EXPORT(depth);

void update_rows(const Update& u, int begin, int end) {
  HWY_DYNAMIC_DISPATCH(update)(u, begin, end);
}

void depth_range(const ToDepth& t, int begin, int end) {
  HWY_DYNAMIC_DISPATCH(depth)(t, begin, end);
}

}  // namespace lcdm::kernels
#endif  // HWY_ONCE
