#include "firmware/nn/kernels/head.h"

#include <bit>

#include "firmware/base/check.h"
#include "firmware/nn/kernels/matrix.h"
#include "firmware/nn/kernels/words.h"

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "firmware/nn/kernels/head.cpp"
#include "firmware/base/simd.h"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
#include "firmware/nn/kernels/head_floats-inl.h"
#include "firmware/nn/kernels/head_pairs-inl.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

void hidden_rows(const HeadStep& s, int begin, int end) {
  const auto channels = static_cast<std::size_t>(s.channels);
  for (int y = begin; y < end; ++y) {
    hidden_row(s, y, s.hidden + static_cast<std::size_t>(y) * s.width * channels, channels);
  }
}

void update_rows(const HeadUpdate& u, int begin, int end, float* scratch) {
  if (u.precision == Precision::kFloat32) {
    float_rows(u, begin, end, scratch);
  } else {
    HeadPairs(u, {begin, end}, scratch).compute();
  }
}

std::size_t update_scratch(const HeadUpdate& u) {
  if (u.precision != Precision::kFloat32) return HeadPairs::scratch_floats(u);
  return 3 * static_cast<std::size_t>(u.step.width + 2) * padded_channels(u.step.channels);
}

// 1 / (0.01 + 9.99 / (1 + e^-logit)) = (1 + e) / (10 + 0.01 e) with e = e^-logit.
void depth(const ToDepth& t, int begin, int end) {
  for_channels(static_cast<std::size_t>(end - begin), [&](auto d, std::size_t i) HWY_ATTR {
    const std::size_t at = static_cast<std::size_t>(begin) + i;
    const auto logit =
        hn::MulAdd(hn::LoadU(d, t.state + at), hn::Set(d, t.deviation), hn::Set(d, t.mean));
    const auto e = exp_approx<-1>(d, logit);
    const auto disparity = hn::MulAdd(e, hn::Set(d, 0.01F), hn::Set(d, 10.0F));
    const auto metres = hn::Div(hn::Add(hn::Set(d, 1.0F), e), disparity);
    // Clamped powers are numbers: where the logit is none, or infinite, it takes the metres with
    // it.
    const auto none = hn::Sub(logit, logit);
    hn::StoreU(hn::MulAdd(metres, hn::Set(d, t.scale), none), d, t.metres + at);
  });
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm::kernels {

HWY_EXPORT(hidden_rows);
HWY_EXPORT(padded_channels);
HWY_EXPORT(update_rows);
HWY_EXPORT(update_scratch);
HWY_EXPORT(depth);

namespace {

float word_of(float first, float second) {
  return std::bit_cast<float>(bfloat16_pair(first, second));
}

}  // namespace

void head_hidden_rows(const HeadStep& step, int begin, int end) {
  HWY_DYNAMIC_DISPATCH(hidden_rows)(step, begin, end);
}

Precision head_precision(Precision wanted, int channels) {
  const bool narrow = wanted >= Precision::kBfloat16 && channels == vector_lanes() &&
                      support_of(Precision::kBfloat16) == Support::kNative;
  return narrow ? Precision::kBfloat16 : Precision::kFloat32;
}

// Words of two neighbours of a row of five taps, the last one's alone.
std::vector<float> pack_composed(std::span<const float> taps, int channels, Precision precision) {
  if (precision == Precision::kFloat32) return {taps.begin(), taps.end()};
  const auto pitch = static_cast<std::size_t>(channels);
  std::vector<float> out;
  for (std::size_t row = 0; row < taps.size(); row += 5 * pitch) {
    for (std::size_t tap = 0; tap < 5; tap += 2) {
      for (std::size_t c = row + tap * pitch; c < row + (tap + 1) * pitch; ++c) {
        out.push_back(word_of(taps[c], tap < 4 ? taps[c + pitch] : 0.0F));
      }
    }
  }
  return out;
}

// Floats are padded to whole vectors; the words of each tap come twice, for both pixels of one.
std::vector<float> pack_update_weights(std::span<const float> taps, int channels,
                                       Precision precision) {
  const auto count = static_cast<std::size_t>(channels);
  LCDM_CHECK(precision == Precision::kFloat32 || count % 2 == 0);
  std::vector<float> out;
  for (std::size_t tap = 0; tap < taps.size(); tap += count) {
    const std::span<const float> of_tap = taps.subspan(tap, count);
    if (precision == Precision::kFloat32) {
      out.insert(out.end(), of_tap.begin(), of_tap.end());
      out.resize(out.size() + HWY_DYNAMIC_DISPATCH(padded_channels)(channels) - count);
    } else {
      for (std::size_t i = 0; i < 2 * count; i += 2) {
        out.push_back(word_of(of_tap[i % count], of_tap[i % count + 1]));
      }
    }
  }
  return out;
}

std::size_t head_update_scratch(const HeadUpdate& u) {
  return HWY_DYNAMIC_DISPATCH(update_scratch)(u);
}

void head_update_rows(const HeadUpdate& u, int begin, int end, float* scratch) {
  HWY_DYNAMIC_DISPATCH(update_rows)(u, begin, end, scratch);
}

void depth_range(const ToDepth& t, int begin, int end) {
  HWY_DYNAMIC_DISPATCH(depth)(t, begin, end);
}

}  // namespace lcdm::kernels
#endif  // HWY_ONCE
