#include "firmware/nn/kernels/attention.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "firmware/nn/kernels/matrix.h"

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "firmware/nn/kernels/attention.cpp"
#include "firmware/base/simd.h"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
#include "firmware/nn/kernels/attention_scores-inl.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

// mixed[c][query] = sum over keys of value[key][c] * scores[key][query] * inverse[query].
template <class Operand, int MR>
HWY_INLINE void mix_rows(const Walk& values, int channel, const FullVec (&inverse)[kQueryVectors],
                         const Buffers<Operand>& b) {
  const FullTag d;
  FullVec acc[MR][kQueryVectors];
  multiply<Operand, MR>(values, channel, b.scores, acc);
  LCDM_UNROLL for (int m = 0; m < MR; ++m) {
    LCDM_UNROLL for (int v = 0; v < kQueryVectors; ++v) {
      hn::StoreU(hn::Mul(acc[m][v], inverse[v]), d,
                 b.mixed + (channel + m) * kQueries + v * kLanes);
    }
  }
}

// All channels of the head.
template <class Operand>
HWY_INLINE void mix(const QueryTile& t, const Walk& values, const FullVec (&inverse)[kQueryVectors],
                    const Buffers<Operand>& b) {
  constexpr int kRows = tile_rows<kQueryVectors>();
  int channel = 0;
  for (; channel + kRows <= t.head_channels; channel += kRows) {
    mix_rows<Operand, kRows>(values, channel, inverse, b);
  }
  if constexpr (kRows > 4) {
    for (; channel + 4 <= t.head_channels; channel += 4) {
      mix_rows<Operand, 4>(values, channel, inverse, b);
    }
  }
  for (; channel + 2 <= t.head_channels; channel += 2) {
    mix_rows<Operand, 2>(values, channel, inverse, b);
  }
  for (; channel < t.head_channels; ++channel) mix_rows<Operand, 1>(values, channel, inverse, b);
}

template <class Operand>
HWY_INLINE void attend(const QueryTile& t, float* out, std::ptrdiff_t out_stride, float* scratch) {
  const FullTag d;
  const Buffers<Operand> b(t, scratch);
  const float scale = kScoreUnits<Operand> / std::sqrt(static_cast<float>(t.head_channels));
  float unit = pack_queries(t, scale, b);
  if (t.first_of_head) {
    b.of_head[Buffers<Operand>::kLongestKey] =
        longest_square(t.keys, t.token_stride, t.tokens, t.head_channels);
  }
  const float square = square_of_scores(t, b);
  const bool small = !Operand::kScaled && square <= kMostScore * kMostScore;
  float value_unit = 1;
  const int channel_words = words_of<Operand>(t.head_channels);
  Walk keys = {t.keys, t.token_stride, 1, channel_words};
  Walk values = {t.values, 1, t.token_stride, words_of<Operand>(t.tokens)};
  if constexpr (Operand::kPrecision != Precision::kFloat32) {
    if (t.first_of_head) pack_keys_and_values(t, b);
    keys = {b.keys, channel_words, 1, channel_words};
    values = {b.values, 1, t.head_channels, words_of<Operand>(t.tokens)};
  }
  if constexpr (Operand::kScaled) {
    unit *= b.of_head[Buffers<Operand>::kKeyScale];
    value_unit = b.of_head[Buffers<Operand>::kValueScale];
  }

  FullVec inverse[kQueryVectors];
  if (!small) {
    compare_scores(t, keys, unit, b, inverse);
  } else if constexpr (!Operand::kScaled) {
    powers(t, keys, b, inverse);
  }
  if constexpr (Operand::kScaled) {
    for (FullVec& v : inverse) v = hn::Mul(v, hn::Set(d, value_unit));
  }
  if (!(square <= kMostFinite)) {  // what cannot be compared must not come out as some depth
    for (FullVec& v : inverse) v = hn::Set(d, std::numeric_limits<float>::quiet_NaN());
  }

  mix(t, values, inverse, b);
  transpose(b.mixed, kQueries, t.head_channels, t.count, 1, out, out_stride);
}

int tiles_of(int tokens) {
  return (tokens + static_cast<int>(kQueries) - 1) / static_cast<int>(kQueries);
}

void attend_range(const Attention& a, int begin, int end, float* scratch) {
  const int tiles = tiles_of(a.tokens);
  const std::ptrdiff_t channels = a.channels;
  const std::ptrdiff_t head_channels = a.channels / a.heads;
  const std::ptrdiff_t token_stride = 3 * channels;
  for (int item = begin; item < end; ++item) {
    const int first = item % tiles * static_cast<int>(kQueries);
    const int head = item / tiles % a.heads;
    const int position = item / tiles / a.heads;
    const std::ptrdiff_t token = static_cast<std::ptrdiff_t>(position) * a.tokens;
    const float* head_qkv = a.qkv + token * token_stride + head * head_channels;
    const QueryTile tile = {head_qkv + first * token_stride,
                            head_qkv + channels,
                            head_qkv + 2 * channels,
                            token_stride,
                            std::min(static_cast<int>(kQueries), a.tokens - first),
                            a.tokens,
                            static_cast<int>(head_channels),
                            item == begin || first == 0};
    float* out = a.output + (token + first) * channels + head * head_channels;
    switch (a.precision) {
      case Precision::kFloat16:
        attend<Float16Operand>(tile, out, channels, scratch);
        break;
      case Precision::kBfloat16:
        attend<Bfloat16Operand>(tile, out, channels, scratch);
        break;
      default:
        attend<FloatOperand>(tile, out, channels, scratch);
    }
  }
}

// Of Buffers, without keys and values.
std::size_t tile_floats(std::size_t tokens, std::size_t head_channels) {
  return (tokens + 2 * head_channels) * kQueries + Buffers<FloatOperand>::kOfHead;
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm::kernels {

HWY_EXPORT(tiles_of);
HWY_EXPORT(attend_range);
HWY_EXPORT(tile_floats);

int attention_items(const Attention& a) {
  return a.positions * a.heads * HWY_DYNAMIC_DISPATCH(tiles_of)(a.tokens);
}

std::size_t attention_scratch(const Attention& a) {
  const auto tokens = static_cast<std::size_t>(a.tokens);
  const auto head_channels = static_cast<std::size_t>(a.channels / a.heads);
  const std::size_t tile = HWY_DYNAMIC_DISPATCH(tile_floats)(tokens, head_channels);
  if (a.precision == Precision::kFloat32) return tile;
  const auto per_word = static_cast<std::size_t>(numbers_per_word(a.precision));
  const auto words = [per_word](std::size_t count) { return (count + per_word - 1) / per_word; };
  return tile + tokens * words(head_channels) + words(tokens) * head_channels;
}

void attention_range(const Attention& a, int begin, int end, float* scratch) {
  HWY_DYNAMIC_DISPATCH(attend_range)(a, begin, end, scratch);
}

}  // namespace lcdm::kernels
#endif  // HWY_ONCE
