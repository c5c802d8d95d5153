#include "firmware/nn/kernels/attention.h"

#include <algorithm>
#include <cmath>

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "firmware/nn/kernels/attention.cpp"
#include "firmware/nn/kernels/simd.h"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
#include "firmware/nn/kernels/gemm-inl.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

// Queries lie along the lanes, so the softmax over keys needs no sum across a vector.
constexpr int kQueryVectors = 3;
constexpr std::size_t kQueries = kQueryVectors * kLanes;

// One tile of queries: pointers to its first query, and to its head's keys and values.
struct QueryTile {
  const float* queries;
  const float* keys;
  const float* values;
  std::ptrdiff_t token_stride;  // floats from one token to the next in q, k and v
  int count;                    // real queries, at most kQueries
  int tokens;
  int head_channels;
};

// packed[c][query] = query[c] * scale; missing queries are zero.
HWY_INLINE void pack_queries(const QueryTile& t, float scale, float* packed) {
  std::fill_n(packed, static_cast<std::size_t>(t.head_channels) * kQueries, 0.0F);
  for (int q = 0; q < t.count; ++q) {
    for (int c = 0; c < t.head_channels; ++c) {
      packed[static_cast<std::size_t>(c) * kQueries + q] =
          t.queries[q * t.token_stride + c] * scale;
    }
  }
}

template <int MR>
HWY_INLINE void score_rows(const QueryTile& t, int key, const float* packed, float* scores,
                           FullVec (&largest)[kQueryVectors]) {
  const FullTag d;
  FullVec acc[MR][kQueryVectors];
  LCDM_UNROLL for (int m = 0; m < MR; ++m) {
    LCDM_UNROLL for (int v = 0; v < kQueryVectors; ++v) acc[m][v] = hn::Zero(d);
  }
  accumulate<MR, kQueryVectors>(d, t.keys + key * t.token_stride, t.token_stride, 1,
                                t.head_channels, packed, acc);
  LCDM_UNROLL for (int m = 0; m < MR; ++m) {
    LCDM_UNROLL for (int v = 0; v < kQueryVectors; ++v) {
      hn::StoreU(acc[m][v], d, scores + (key + m) * kQueries + v * kLanes);
      largest[v] = hn::Max(largest[v], acc[m][v]);
    }
  }
}

// scores[key][query] <- exp(score - largest of the query); returns 1 / their sums.
HWY_INLINE void softmax(const QueryTile& t, const FullVec (&largest)[kQueryVectors], float* scores,
                        FullVec (&inverse)[kQueryVectors]) {
  const FullTag d;
  for (int v = 0; v < kQueryVectors; ++v) {
    FullVec sum = hn::Zero(d);
    float* score = scores + v * kLanes;
    for (int key = 0; key < t.tokens; ++key, score += kQueries) {
      const FullVec e = exp_approx(d, hn::Sub(hn::LoadU(d, score), largest[v]));
      hn::StoreU(e, d, score);
      sum = hn::Add(sum, e);
    }
    inverse[v] = hn::Div(hn::Set(d, 1.0F), sum);
  }
}

// mixed[c][query] = sum over keys of value[key][c] * scores[key][query] * inverse[query].
template <int MR>
HWY_INLINE void mix_rows(const QueryTile& t, int channel, const float* scores,
                         const FullVec (&inverse)[kQueryVectors], float* mixed) {
  const FullTag d;
  FullVec acc[MR][kQueryVectors];
  LCDM_UNROLL for (int m = 0; m < MR; ++m) {
    LCDM_UNROLL for (int v = 0; v < kQueryVectors; ++v) acc[m][v] = hn::Zero(d);
  }
  accumulate<MR, kQueryVectors>(d, t.values + channel, 1, t.token_stride, t.tokens, scores, acc);
  LCDM_UNROLL for (int m = 0; m < MR; ++m) {
    LCDM_UNROLL for (int v = 0; v < kQueryVectors; ++v) {
      hn::StoreU(hn::Mul(acc[m][v], inverse[v]), d, mixed + (channel + m) * kQueries + v * kLanes);
    }
  }
}

// `scratch` holds packed queries and mixed values [head_channels, kQueries] and the scores
// [tokens, kQueries].
HWY_INLINE void attend(const QueryTile& t, float* out, std::ptrdiff_t out_stride, float* scratch) {
  constexpr int kRows = tile_rows<kQueryVectors>();
  const FullTag d;
  float* packed = scratch;
  float* mixed = packed + static_cast<std::size_t>(t.head_channels) * kQueries;
  float* scores = mixed + static_cast<std::size_t>(t.head_channels) * kQueries;
  pack_queries(t, 1.0F / std::sqrt(static_cast<float>(t.head_channels)), packed);

  FullVec largest[kQueryVectors];
  for (FullVec& v : largest) v = hn::Set(d, -3.0e38F);
  int key = 0;
  for (; key + kRows <= t.tokens; key += kRows) {
    score_rows<kRows>(t, key, packed, scores, largest);
  }
  for (; key < t.tokens; ++key) score_rows<1>(t, key, packed, scores, largest);

  FullVec inverse[kQueryVectors];
  softmax(t, largest, scores, inverse);

  int channel = 0;
  for (; channel + kRows <= t.head_channels; channel += kRows) {
    mix_rows<kRows>(t, channel, scores, inverse, mixed);
  }
  for (; channel + 2 <= t.head_channels; channel += 2) {
    mix_rows<2>(t, channel, scores, inverse, mixed);
  }
  for (; channel < t.head_channels; ++channel) mix_rows<1>(t, channel, scores, inverse, mixed);

  for (int q = 0; q < t.count; ++q) {
    for (int c = 0; c < t.head_channels; ++c) {
      out[q * out_stride + c] = mixed[static_cast<std::size_t>(c) * kQueries + q];
    }
  }
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
                            static_cast<int>(head_channels)};
    attend(tile, a.output + (token + first) * channels + head * head_channels, a.channels, scratch);
  }
}

int query_tile() { return static_cast<int>(kQueries); }

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm::kernels {

HWY_EXPORT(tiles_of);
HWY_EXPORT(attend_range);
HWY_EXPORT(query_tile);

int attention_items(const Attention& a) {
  return a.positions * a.heads * HWY_DYNAMIC_DISPATCH(tiles_of)(a.tokens);
}

std::size_t attention_scratch(const Attention& a) {
  const std::size_t rows =
      static_cast<std::size_t>(a.tokens) + 2 * static_cast<std::size_t>(a.channels / a.heads);
  return rows * static_cast<std::size_t>(HWY_DYNAMIC_DISPATCH(query_tile)());
}

void attention_range(const Attention& a, int begin, int end, float* scratch) {
  HWY_DYNAMIC_DISPATCH(attend_range)(a, begin, end, scratch);
}

}  // namespace lcdm::kernels
#endif  // HWY_ONCE
