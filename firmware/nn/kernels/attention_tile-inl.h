// A tile of queries of one head, and its queries, keys and values as words.
#if defined(LCDM_KERNELS_ATTENTION_TILE_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef LCDM_KERNELS_ATTENTION_TILE_INL_H
#undef LCDM_KERNELS_ATTENTION_TILE_INL_H
#else
#define LCDM_KERNELS_ATTENTION_TILE_INL_H
#endif

#include <algorithm>
#include <cstddef>
#include <limits>

#include "firmware/nn/kernels/gemm-inl.h"

#include "hwy/cache_control.h"

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
constexpr float kMostFinite = std::numeric_limits<float>::max();
// Its power counts as 0: for the key that a pair lacks.
constexpr float kNoScore = -127;

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

// Rows of one head lie far apart, where no processor looks ahead: they are asked for as many rows
// before they are read.
constexpr int kRowsAhead = 12;

HWY_INLINE void fetch_row(const float* row, int numbers) {
  hwy::Prefetch(row);
  hwy::Prefetch(row + numbers - 1);
}

// to[column][row] = from[row][column] * factor.
HWY_INLINE void transpose(const float* from, std::ptrdiff_t from_stride, int rows, int columns,
                          float factor, float* to, std::ptrdiff_t to_stride) {
  int row = 0;
#if HWY_TARGET != HWY_SCALAR
  const HWY_CAPPED(float, 4) d;
  const int whole = columns / 4 * 4;
  for (; row + 4 <= rows; row += 4) {
    const float* at = from + row * from_stride;
    for (int r = 0; r < 4; ++r) {
      fetch_row(at + std::min(kRowsAhead + r, rows - 1 - row) * from_stride, columns);
    }
    for (int column = 0; column < whole; column += 4) {
      const auto load = [&](int r) HWY_ATTR {
        return hn::Mul(hn::LoadU(d, at + r * from_stride + column), hn::Set(d, factor));
      };
      const auto a = load(0);
      const auto b = load(1);
      const auto c = load(2);
      const auto e = load(3);
      const auto ab01 = hn::InterleaveLower(d, a, b);
      const auto ab23 = hn::InterleaveUpper(d, a, b);
      const auto ce01 = hn::InterleaveLower(d, c, e);
      const auto ce23 = hn::InterleaveUpper(d, c, e);
      float* out = to + column * to_stride + row;
      hn::StoreU(hn::ConcatLowerLower(d, ce01, ab01), d, out);
      hn::StoreU(hn::ConcatUpperUpper(d, ce01, ab01), d, out + to_stride);
      hn::StoreU(hn::ConcatLowerLower(d, ce23, ab23), d, out + 2 * to_stride);
      hn::StoreU(hn::ConcatUpperUpper(d, ce23, ab23), d, out + 3 * to_stride);
    }
    for (int column = whole; column < columns; ++column) {
      for (int r = 0; r < 4; ++r)
        to[column * to_stride + row + r] = at[r * from_stride + column] * factor;
    }
  }
#endif
  for (; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      to[column * to_stride + row] = from[row * from_stride + column] * factor;
    }
  }
}

// queries[c][query] = query[c] * scale; missing queries are zero. Returns what they were divided
// by.
template <class Operand>
HWY_INLINE float pack_queries(const QueryTile& t, float scale, const Buffers<Operand>& b) {
  const FullTag d;
  float* turned = b.mixed;  // not in use yet
  if (t.count < static_cast<int>(kQueries)) {
    std::fill_n(turned, static_cast<std::size_t>(t.head_channels) * kQueries, 0.0F);
  }
  transpose(t.queries, t.token_stride, t.count, t.head_channels, scale, turned, kQueries);
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

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#endif
