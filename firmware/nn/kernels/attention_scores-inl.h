// The scores of a tile of queries, and the softmax over their keys.
#if defined(LCDM_KERNELS_ATTENTION_SCORES_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef LCDM_KERNELS_ATTENTION_SCORES_INL_H
#undef LCDM_KERNELS_ATTENTION_SCORES_INL_H
#else
#define LCDM_KERNELS_ATTENTION_SCORES_INL_H
#endif

#include <algorithm>
#include <bit>
#include <cstddef>

#include "firmware/nn/kernels/attention_tile-inl.h"

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

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

// e^((score - largest) * unit).
template <class Operand>
HWY_INLINE FullVec power_of(FullTag d, FullVec score, FullVec largest,
                            [[maybe_unused]] float unit) {
  if constexpr (Operand::kScaled) {
    return rough_exp_minus(d, hn::Mul(hn::Sub(largest, score), hn::Set(d, unit)));
  } else {
    const FullVec x = hn::Max(hn::Sub(score, largest), hn::Set(d, -126.0F));
    if constexpr (kPerWord<Operand> != 1) return rough_exp2_within(d, x);
    return exp2_times_constant(d, x, kPowerTerms);
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
  const PowerTerms& terms = *read_only_now(&kPowerTerms);
  float* word = b.scores + key / kWord * static_cast<int>(kQueries);
  LCDM_UNROLL for (int m = 0; m < MR; m += kWord, word += kQueries) {
    LCDM_UNROLL for (int v = 0; v < kQueryVectors; ++v) {
      if constexpr (kWord == 1) {
        const FullVec power = exp2_times_constant(d, acc[m][v], terms);
        sum[v] = hn::Add(sum[v], power);
        hn::StoreU(power, d, word + v * kLanes);
      } else {
        const FullVec next = m + 1 < MR ? acc[m + 1][v] : hn::Set(d, kNoScore);
        const FullVec powers = Operand::pair_of_powers(d, acc[m][v], next);
        sum[v] = Operand::dot(d, Operand::ones(d), powers, sum[v]);
        hn::StoreU(powers, d, word + v * kLanes);
      }
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

// The square of the longest of `count` rows; infinite or no number where one of them is.
HWY_INLINE float longest_square(const float* rows, std::ptrdiff_t stride, int count, int numbers) {
  float longest = 0;
  const HWY_CAPPED(float, 4) d;  // of a head's few numbers larger vectors would leave more
  const int step = static_cast<int>(hn::Lanes(d));
  for (int row = 0; row < count; ++row, rows += stride) {
    fetch_row(rows + std::min(kRowsAhead, count - 1 - row) * stride, numbers);
    auto sum = hn::Zero(d);
    float rest = 0;
    int i = 0;
    for (; i + step <= numbers; i += step) {
      const auto v = hn::LoadU(d, rows + i);
      sum = hn::MulAdd(v, v, sum);
    }
    for (; i < numbers; ++i) rest += rows[i] * rows[i];
    const float square = rest + hn::GetLane(hn::SumOfLanes(d, sum));
    if (!(square <= kMostFinite)) return square;
    longest = std::max(longest, square);
  }
  return longest;
}

// No score of this tile has a larger square: none is more than the product of its query's and its
// key's lengths. Infinite or no number where a score may be. Queries are as pack_queries turned
// them.
template <class Operand>
HWY_INLINE float square_of_scores(const QueryTile& t, const Buffers<Operand>& b) {
  const FullTag d;
  const hn::RebindToSigned<FullTag> di;
  auto longest = hn::Zero(di);  // as bits, of which those of no number are the largest
  for (std::size_t q = 0; q < kQueries; q += kLanes) {
    FullVec sum = hn::Zero(d);
    for (int c = 0; c < t.head_channels; ++c) {
      const FullVec v = hn::LoadU(d, b.mixed + static_cast<std::size_t>(c) * kQueries + q);
      sum = hn::MulAdd(v, v, sum);
    }
    longest = hn::Max(longest, hn::BitCast(di, hn::Abs(sum)));
  }
  const auto of_queries = std::bit_cast<float>(hn::GetLane(hn::MaxOfLanes(di, longest)));
  return of_queries * b.of_head[Buffers<Operand>::kLongestKey];
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

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#endif
