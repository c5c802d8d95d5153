#include "firmware/nn/kernels/norm.h"

#include <cmath>

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "firmware/nn/kernels/norm.cpp"
#include "firmware/base/simd.h"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
#include "firmware/nn/kernels/math-inl.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

// Sum of f(tag, c) over all channels; f returns a vector.
template <class F>
HWY_INLINE float sum_channels(std::size_t channels, F&& f) {
  const FullTag full;
  FullVec wide = hn::Zero(full);
  std::size_t c = 0;
  for (; c + hn::Lanes(full) <= channels; c += hn::Lanes(full)) wide = hn::Add(wide, f(full, c));
  float sum = hn::GetLane(hn::SumOfLanes(full, wide));
  const HWY_CAPPED(float, 1) one;
  for (; c < channels; ++c) sum += hn::GetLane(f(one, c));
  return sum;
}

void layer_norm(const LayerNorm& norm, int begin, int end) {
  const auto channels = static_cast<std::size_t>(norm.channels);
  const float share = 1.0F / static_cast<float>(norm.channels);
  for (int row = begin; row < end; ++row) {
    const float* in = norm.input + row * channels;
    float* out = norm.output + row * channels;
    const float mean = share * sum_channels(channels, [&](auto d, std::size_t c) HWY_ATTR {
                         return hn::LoadU(d, in + c);
                       });
    const float variance = share * sum_channels(channels, [&](auto d, std::size_t c) HWY_ATTR {
                             const auto x = hn::Sub(hn::LoadU(d, in + c), hn::Set(d, mean));
                             return hn::Mul(x, x);
                           });
    const float scale = 1.0F / std::sqrt(variance + norm.epsilon);
    for_channels(channels, [&](auto d, std::size_t c) HWY_ATTR {
      const auto x = hn::Sub(hn::LoadU(d, in + c), hn::Set(d, mean));
      const auto w = hn::Mul(hn::LoadU(d, norm.weight + c), hn::Set(d, scale));
      hn::StoreU(hn::MulAdd(x, w, hn::LoadU(d, norm.bias + c)), d, out + c);
    });
  }
}

// Sum of f(x) over a row, in four sums that need not wait for each other.
template <class D, class F>
HWY_INLINE hn::Vec<D> sum_of_row(D d, int width, F&& f) {
  hn::Vec<D> sum[4];
  LCDM_UNROLL for (int i = 0; i < 4; ++i) sum[i] = hn::Zero(d);
  int x = 0;
  for (; x + 4 <= width; x += 4) {
    LCDM_UNROLL for (int i = 0; i < 4; ++i) sum[i] = hn::Add(sum[i], f(x + i));
  }
  for (; x < width; ++x) sum[0] = hn::Add(sum[0], f(x));
  return hn::Add(hn::Add(sum[0], sum[1]), hn::Add(sum[2], sum[3]));
}

// Squares of the differences from the row's own mean, not of the values: where these are all alike,
// sums of squares differ by less than their rounding.
void row_moments(const GroupNorm& norm, int begin, int end) {
  const auto channels = static_cast<std::size_t>(norm.channels);
  const float share = 1.0F / static_cast<float>(norm.width);
  for (int y = begin; y < end; ++y) {
    const float* in = norm.input + static_cast<std::size_t>(y) * norm.width * channels;
    float* moments = norm.row_moments + static_cast<std::size_t>(y) * 2 * channels;
    for_channels(channels, [&](auto d, std::size_t c) HWY_ATTR {
      const auto value = [&](int x) HWY_ATTR { return hn::LoadU(d, in + x * channels + c); };
      const auto first = value(0);  // sums of what is left of it are small
      const auto sum =
          sum_of_row(d, norm.width, [&](int x) HWY_ATTR { return hn::Sub(value(x), first); });
      const auto mean = hn::MulAdd(sum, hn::Set(d, share), first);
      const auto squares = sum_of_row(d, norm.width, [&](int x) HWY_ATTR {
        const auto v = hn::Sub(value(x), mean);
        return hn::Mul(v, v);
      });
      hn::StoreU(mean, d, moments + c);
      hn::StoreU(hn::Mul(squares, hn::Set(d, share)), d, moments + channels + c);
    });
  }
}

// Mean and 1 / deviation of one group from all its rows' moments.
HWY_INLINE void group_statistics(const GroupNorm& norm, int group, float& mean, float& scale) {
  const int members = norm.channels / norm.groups;
  const auto each = [&](auto&& use) {
    for (int y = 0; y < norm.height; ++y) {
      const float* moments = norm.row_moments + static_cast<std::size_t>(y) * 2 * norm.channels;
      for (int c = group * members; c < (group + 1) * members; ++c) {
        use(static_cast<double>(moments[c]), static_cast<double>(moments[norm.channels + c]));
      }
    }
  };
  const double share = 1.0 / (static_cast<double>(norm.height) * members);
  double average = 0;
  each([&](double of_row, double) { average += share * of_row; });
  double variance = 0;
  each([&](double of_row, double within) {
    variance += share * (within + (of_row - average) * (of_row - average));
  });
  mean = static_cast<float>(average);
  scale = static_cast<float>(1 / std::sqrt(variance + static_cast<double>(norm.epsilon)));
}

void apply_group_norm(const GroupNorm& norm, int begin, int end) {
  const auto pitch = static_cast<std::size_t>(norm.channels);
  const int members = norm.channels / norm.groups;
  for (int group = 0; group < norm.groups; ++group) {
    float mean = 0;
    float scale = 0;
    group_statistics(norm, group, mean, scale);
    const auto first = static_cast<std::size_t>(group) * members;
    for_channels(static_cast<std::size_t>(members), [&](auto d, std::size_t i) HWY_ATTR {
      const std::size_t c = first + i;
      const auto w = hn::Mul(hn::LoadU(d, norm.weight + c), hn::Set(d, scale));
      const auto b = hn::NegMulAdd(hn::Set(d, mean), w, hn::LoadU(d, norm.bias + c));
      const std::size_t pixels_end = static_cast<std::size_t>(end) * norm.width;
      for (std::size_t p = static_cast<std::size_t>(begin) * norm.width; p < pixels_end; ++p) {
        const auto v = hn::MulAdd(hn::LoadU(d, norm.input + p * pitch + c), w, b);
        with_activation(norm.activation, [&](auto kind) HWY_ATTR {
          hn::StoreU(activate<decltype(kind)::value>(d, v), d, norm.output + p * pitch + c);
        });
      }
    });
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm::kernels {

HWY_EXPORT(layer_norm);
HWY_EXPORT(row_moments);
HWY_EXPORT(apply_group_norm);

void layer_norm_rows(const LayerNorm& norm, int begin, int end) {
  HWY_DYNAMIC_DISPATCH(layer_norm)(norm, begin, end);
}

void group_norm_moments(const GroupNorm& norm, int begin, int end) {
  HWY_DYNAMIC_DISPATCH(row_moments)(norm, begin, end);
}

void group_norm_apply(const GroupNorm& norm, int begin, int end) {
  HWY_DYNAMIC_DISPATCH(apply_group_norm)(norm, begin, end);
}

}  // namespace lcdm::kernels
#endif  // HWY_ONCE
