#include "firmware/nn/kernels/attention.h"

#include <algorithm>
#include <cmath>

#include "firmware/nn/kernels/matrix.h"

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "firmware/nn/kernels/attention.cpp"
#include "firmware/base/simd.h"
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
  bool first_of_head;  // of this call; later ones find keys and values packed
};

template <class Operand>
constexpr int kPerWord = numbers_per_word(Operand::kPrecision);

// Scores that need no other unit are in log(2)'s, so that e^score is a power of two.
template <class Operand>
constexpr float kScoreUnits = Operand::kScaled ? 1.0F : 1.44269504F;

// Scores no larger than this, of either sign, need not be compared with the largest of their query
// before they become powers of two: these and their sums stay far from a float's ends.
constexpr float kMostScore = 60;

// The operand's numbers of one word, from rows that are `step` apart, times `factor` where it is
// scaled; what is beyond `count` is 0.
template <class Operand, class D>
HWY_INLINE hn::Vec<D> load_word(D d, const float* from, std::ptrdiff_t step, int count,
                                float factor) {
  auto low = hn::LoadU(d, from);
  if constexpr (kPerWord<Operand> == 1) {
    return low;
  } else {
    auto high = count > 1 ? hn::LoadU(d, from + step) : hn::Zero(d);
    if constexpr (Operand::kScaled) {
      low = hn::Mul(low, hn::Set(d, factor));
      high = hn::Mul(high, hn::Set(d, factor));
    }
    return Operand::pair(d, low, high);
  }
}

// What rows are divided by before they are made narrow.
template <class Operand>
HWY_INLINE PowerOfTwo scale_of(const float* rows, std::ptrdiff_t stride, int count, int numbers) {
  if constexpr (!Operand::kScaled) return {};
  return power_of_two_within(largest_magnitude(rows, stride, count, numbers));
}

// Words of `count` rows of the operand.
template <class Operand>
constexpr int words_of(int count) {
  return (count + kPerWord<Operand> - 1) / kPerWord<Operand>;
}

// What a tile works with, all in scratch.
template <class Operand>
struct Buffers {
  float* queries;  // [words of head_channels, kQueries]
  float* mixed;    // [head_channels, kQueries]
  float* scores;   // [tokens, kQueries]; then words of two tokens each, from the front
  float* of_head;  // what keys and values were divided by; the square of the longest key
  float* keys;     // [tokens, words of head_channels]; floats stay where they are, without room
  float* values;   // [words of tokens, head_channels]; alike

  static constexpr int kKeyScale = 0;
  static constexpr int kValueScale = 1;
  static constexpr int kLongestKey = 2;
  static constexpr std::size_t kOfHead = 3;

  // As attention_scratch counts.
  HWY_INLINE Buffers(const QueryTile& t, float* scratch) {
    const auto channels = static_cast<std::size_t>(t.head_channels);
    const auto tokens = static_cast<std::size_t>(t.tokens);
    mixed = scratch;
    queries = mixed + channels * kQueries;
    scores = queries + channels * kQueries;
    of_head = scores + tokens * kQueries;
    keys = of_head + kOfHead;
    values = keys + tokens * static_cast<std::size_t>(words_of<Operand>(t.head_channels));
  }
};

// queries[c][query] = query[c] * scale; missing queries are zero. Returns what they were divided
// by.
template <class Operand>
HWY_INLINE float pack_queries(const QueryTile& t, float scale, const Buffers<Operand>& b) {
  const FullTag d;
  float* turned = b.mixed;  // not in use yet
  std::fill_n(turned, static_cast<std::size_t>(t.head_channels) * kQueries, 0.0F);
  for (int q = 0; q < t.count; ++q) {
    for (int c = 0; c < t.head_channels; ++c) {
      turned[static_cast<std::size_t>(c) * kQueries + q] =
          t.queries[q * t.token_stride + c] * scale;
    }
  }
  const PowerOfTwo by = scale_of<Operand>(turned, kQueries, t.head_channels, kQueries);
  for (int c = 0; c < t.head_channels; c += kPerWord<Operand>) {
    const float* from = turned + static_cast<std::size_t>(c) * kQueries;
    float* to = b.queries + static_cast<std::size_t>(c / kPerWord<Operand>) * kQueries;
    for (std::size_t q = 0; q < kQueries; q += kLanes) {
      hn::StoreU(load_word<Operand>(d, from + q, kQueries, t.head_channels - c, by.inverse), d,
                 to + q);
    }
  }
  return by.value;
}

// Keys and values as words, where they are not floats.
template <class Operand>
HWY_INLINE void pack_keys_and_values(const QueryTile& t, const Buffers<Operand>& b) {
  const PowerOfTwo of_keys = scale_of<Operand>(t.keys, t.token_stride, t.tokens, t.head_channels);
  const PowerOfTwo of_values =
      scale_of<Operand>(t.values, t.token_stride, t.tokens, t.head_channels);
  if constexpr (Operand::kScaled) {
    b.of_head[Buffers<Operand>::kKeyScale] = of_keys.value;
    b.of_head[Buffers<Operand>::kValueScale] = of_values.value;
  }
  for (int token = 0; token < t.tokens; ++token) {
    const float* from = t.keys + token * t.token_stride;
    float* to = b.keys + token * words_of<Operand>(t.head_channels);
    if constexpr (Operand::kScaled) {
      Operand::narrow(from, t.head_channels, of_keys.inverse, to);
    } else {
      Operand::narrow(from, t.head_channels, to);
    }
  }
  for (int token = 0; token < t.tokens; token += kPerWord<Operand>) {
    const float* from = t.values + token * t.token_stride;
    float* to = b.values + token / kPerWord<Operand> * t.head_channels;
    for_channels(static_cast<std::size_t>(t.head_channels), [&](auto d, std::size_t c) HWY_ATTR {
      hn::StoreU(
          load_word<Operand>(d, from + c, t.token_stride, t.tokens - token, of_values.inverse), d,
          to + c);
    });
  }
}

// A matrix of words that `accumulate` walks through.
struct Walk {
  const float* data;
  std::ptrdiff_t row_stride;
  std::ptrdiff_t k_stride;
  int depth;
};

// The scores of keys from `key` on, or the mixed channels from there on.
template <class Operand, int MR>
HWY_INLINE void multiply(const Walk& rows, int row, const float* b,
                         FullVec (&acc)[MR][kQueryVectors]) {
  const FullTag d;
  LCDM_UNROLL for (int m = 0; m < MR; ++m) {
    LCDM_UNROLL for (int v = 0; v < kQueryVectors; ++v) acc[m][v] = hn::Zero(d);
  }
  accumulate<Operand, MR, kQueryVectors>(d, rows.data + row * rows.row_stride, rows.row_stride,
                                         rows.k_stride, rows.depth, b, acc);
}

template <class Operand, int MR>
HWY_INLINE void score_rows(const Walk& keys, int key, const Buffers<Operand>& b,
                           FullVec (&largest)[kQueryVectors]) {
  const FullTag d;
  FullVec acc[MR][kQueryVectors];
  multiply<Operand, MR>(keys, key, b.queries, acc);
  LCDM_UNROLL for (int m = 0; m < MR; ++m) {
    LCDM_UNROLL for (int v = 0; v < kQueryVectors; ++v) {
      hn::StoreU(acc[m][v], d, b.scores + (key + m) * kQueries + v * kLanes);
      largest[v] = hn::Max(largest[v], acc[m][v]);
    }
  }
}

// 2^score where that is within 126 of 0.
template <class Operand>
HWY_INLINE FullVec power_within(FullTag d, FullVec score) {
  if constexpr (kPerWord<Operand> == 1) {
    return exp2_within(d, score);
  } else {
    return rough_exp2_within(d, score);
  }
}

// e^((score - largest) * unit).
template <class Operand>
HWY_INLINE FullVec power_of(FullTag d, FullVec score, FullVec largest,
                            [[maybe_unused]] float unit) {
  if constexpr (Operand::kScaled) {
    return rough_exp_minus(d, hn::Mul(hn::Sub(largest, score), hn::Set(d, unit)));
  } else {
    return power_within<Operand>(d, hn::Max(hn::Sub(score, largest), hn::Set(d, -126.0F)));
  }
}

// scores[key][query] = 2^score at once, as words; adds them to their sums.
template <class Operand, int MR>
HWY_INLINE void power_rows(const Walk& keys, int key, const Buffers<Operand>& b,
                           FullVec (&sum)[kQueryVectors]) {
  constexpr int kWord = kPerWord<Operand>;
  const FullTag d;
  FullVec acc[MR][kQueryVectors];
  multiply<Operand, MR>(keys, key, b.queries, acc);
  float* word = b.scores + key / kWord * static_cast<int>(kQueries);
  LCDM_UNROLL for (int m = 0; m < MR; m += kWord, word += kQueries) {
    LCDM_UNROLL for (int v = 0; v < kQueryVectors; ++v) {
      FullVec e = power_within<Operand>(d, acc[m][v]);
      sum[v] = hn::Add(sum[v], e);
      if constexpr (kWord == 2) {
        FullVec next = hn::Zero(d);
        if (m + 1 < MR) {
          next = power_within<Operand>(d, acc[m + 1][v]);
          sum[v] = hn::Add(sum[v], next);
        }
        e = Operand::pair(d, e, next);
      }
      hn::StoreU(e, d, word + v * kLanes);
    }
  }
}

// scores <- 2^score as words; returns 1 / their sums.
template <class Operand>
HWY_INLINE void powers(const QueryTile& t, const Walk& keys, const Buffers<Operand>& b,
                       FullVec (&inverse)[kQueryVectors]) {
  constexpr int kRows = tile_rows<kQueryVectors>();
  const FullTag d;
  FullVec sum[kQueryVectors];
  for (FullVec& v : sum) v = hn::Zero(d);
  int key = 0;
  for (; key + kRows <= t.tokens; key += kRows) power_rows<Operand, kRows>(keys, key, b, sum);
  for (; key + 2 <= t.tokens; key += 2) power_rows<Operand, 2>(keys, key, b, sum);
  for (; key < t.tokens; ++key) power_rows<Operand, 1>(keys, key, b, sum);
  for (int v = 0; v < kQueryVectors; ++v) inverse[v] = hn::Div(hn::Set(d, 1.0F), sum[v]);
}

// The square of the longest of `count` rows.
HWY_INLINE float longest_square(const float* rows, std::ptrdiff_t stride, int count, int numbers) {
  float longest = 0;
  for (int row = 0; row < count; ++row, rows += stride) {
    const FullTag d;
    constexpr int kStep = static_cast<int>(kLanes);
    FullVec sum = hn::Zero(d);
    float rest = 0;
    int i = 0;
    for (; i + kStep <= numbers; i += kStep) {
      const FullVec v = hn::LoadU(d, rows + i);
      sum = hn::MulAdd(v, v, sum);
    }
    for (; i < numbers; ++i) rest += rows[i] * rows[i];
    longest = std::max(longest, rest + hn::GetLane(hn::SumOfLanes(d, sum)));
  }
  return longest;
}

// Whether all scores of this tile are within kMostScore: none is more than the product of its
// query's and its key's lengths. Queries are as pack_queries turned them.
template <class Operand>
HWY_INLINE bool scores_are_small(const QueryTile& t, const Buffers<Operand>& b) {
  const FullTag d;
  FullVec longest = hn::Zero(d);
  for (std::size_t q = 0; q < kQueries; q += kLanes) {
    FullVec sum = hn::Zero(d);
    for (int c = 0; c < t.head_channels; ++c) {
      const FullVec v = hn::LoadU(d, b.mixed + static_cast<std::size_t>(c) * kQueries + q);
      sum = hn::MulAdd(v, v, sum);
    }
    longest = hn::Max(longest, sum);
  }
  const float of_queries = hn::GetLane(hn::MaxOfLanes(d, longest));
  return of_queries * b.of_head[Buffers<Operand>::kLongestKey] <= kMostScore * kMostScore;
}

// scores[key][query] <- exp((score - largest of the query) * unit), as words; returns 1 / their
// sums.
template <class Operand>
HWY_INLINE void softmax(const QueryTile& t, float unit, const FullVec (&largest)[kQueryVectors],
                        const Buffers<Operand>& b, FullVec (&inverse)[kQueryVectors]) {
  constexpr bool kPairs = kPerWord<Operand> == 2;
  const FullTag d;
  for (int v = 0; v < kQueryVectors; ++v) {
    FullVec sum = hn::Zero(d);
    const float* score = b.scores + v * kLanes;
    float* word = b.scores + v * kLanes;
    const auto next = [&] HWY_ATTR {
      const FullVec e = power_of<Operand>(d, hn::LoadU(d, score), largest[v], unit);
      score += kQueries;
      sum = hn::Add(sum, e);
      return e;
    };
    for (int key = 0; key < t.tokens; key += kPerWord<Operand>, word += kQueries) {
      FullVec e = next();
      if constexpr (kPairs) e = Operand::pair(d, e, key + 1 < t.tokens ? next() : hn::Zero(d));
      hn::StoreU(e, d, word);
    }
    inverse[v] = hn::Div(hn::Set(d, 1.0F), sum);
  }
}

// The same of scores of any size, compared with the largest of their query.
template <class Operand>
HWY_INLINE void compare_scores(const QueryTile& t, const Walk& keys, float unit,
                               const Buffers<Operand>& b, FullVec (&inverse)[kQueryVectors]) {
  constexpr int kRows = tile_rows<kQueryVectors>();
  const FullTag d;
  FullVec largest[kQueryVectors];
  for (FullVec& v : largest) v = hn::Set(d, -3.0e38F);
  int key = 0;
  for (; key + kRows <= t.tokens; key += kRows) score_rows<Operand, kRows>(keys, key, b, largest);
  for (; key < t.tokens; ++key) score_rows<Operand, 1>(keys, key, b, largest);
  softmax(t, unit, largest, b, inverse);
}

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

template <class Operand>
HWY_INLINE void attend(const QueryTile& t, float* out, std::ptrdiff_t out_stride, float* scratch) {
  constexpr int kRows = tile_rows<kQueryVectors>();
  const FullTag d;
  const Buffers<Operand> b(t, scratch);
  const float scale = kScoreUnits<Operand> / std::sqrt(static_cast<float>(t.head_channels));
  float unit = pack_queries(t, scale, b);
  bool small = false;
  if constexpr (!Operand::kScaled) {
    if (t.first_of_head) {
      b.of_head[Buffers<Operand>::kLongestKey] =
          longest_square(t.keys, t.token_stride, t.tokens, t.head_channels);
    }
    small = scores_are_small(t, b);
  }
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
  for (; channel < t.head_channels; ++channel) {
    mix_rows<Operand, 1>(values, channel, inverse, b);
  }

  for (int q = 0; q < t.count; ++q) {
    for (int c = 0; c < t.head_channels; ++c) {
      out[q * out_stride + c] = b.mixed[static_cast<std::size_t>(c) * kQueries + q];
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
