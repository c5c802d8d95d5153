// Rows of a 3x3 convolution as row_winograd.h transforms them, and their products.
#if defined(LCDM_KERNELS_ROW_WINOGRAD_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef LCDM_KERNELS_ROW_WINOGRAD_INL_H
#undef LCDM_KERNELS_ROW_WINOGRAD_INL_H
#else
#define LCDM_KERNELS_ROW_WINOGRAD_INL_H
#endif

#include <cstddef>
#include <cstring>

#include "firmware/nn/kernels/bfloat16-inl.h"
#include "firmware/nn/kernels/math-inl.h"
#include "firmware/nn/kernels/matrix.h"
#include "firmware/nn/kernels/row_winograd.h"

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

// Calls put(d, pair, c, d1 + d2, d2 - d1, d0 - d2, d3 - d1) with the channels from c on of every
// pair of pixels. `pixels` is [2 * pairs + 2, channels].
template <class Put>
HWY_INLINE void transform_pairs(const float* pixels, int pairs, int channels, const Put& put) {
  const std::ptrdiff_t step = channels;
  for (int pair = 0; pair < pairs; ++pair, pixels += 2 * step) {
    for_channels(static_cast<std::size_t>(channels), [&](auto d, std::size_t c) HWY_ATTR {
      const float* at = pixels + c;
      const auto d0 = hn::LoadU(d, at);
      const auto d1 = hn::LoadU(d, at + step);
      const auto d2 = hn::LoadU(d, at + 2 * step);
      const auto d3 = hn::LoadU(d, at + 3 * step);
      put(d, pair, c, hn::Add(d1, d2), hn::Sub(d2, d1), hn::Sub(d0, d2), hn::Sub(d3, d1));
    });
  }
}

HWY_INLINE void transform_to_floats(const float* pixels, int pairs, int channels, float* out) {
  const std::ptrdiff_t step = channels;
  transform_pairs(pixels, pairs, channels,
                  [=](auto d, int pair, std::size_t c, auto sum, auto rise, auto left, auto right)
                      HWY_ATTR {
                        float* to = out + pair * step * kRowProducts + c;
                        hn::StoreU(sum, d, to);
                        hn::StoreU(rise, d, to + step);
                        hn::StoreU(left, d, to + 2 * step);
                        hn::StoreU(right, d, to + 3 * step);
                      });
}

HWY_INLINE void transform_to_halves(const float* pixels, int pairs, int channels, float* out) {
#if LCDM_NATIVE_BFLOAT16
  const std::ptrdiff_t pixel = channels / 2;
  transform_pairs(pixels, pairs, channels,
                  [=](auto d, int pair, std::size_t c, auto sum, auto rise, auto left, auto right)
                      HWY_ATTR {
                        if constexpr (hn::MaxLanes(decltype(d)()) > 1) {  // channels come in fours
                          const hn::Half<decltype(d)> half;
                          const auto first = Bfloat16Operand::joined(d, sum, rise);
                          const auto last = Bfloat16Operand::joined(d, left, right);
                          float* to = out + pair * pixel * kRowProducts + c / 2;
                          hn::StoreU(hn::LowerHalf(half, first), half, to);
                          hn::StoreU(hn::UpperHalf(half, first), half, to + pixel);
                          hn::StoreU(hn::LowerHalf(half, last), half, to + 2 * pixel);
                          hn::StoreU(hn::UpperHalf(half, last), half, to + 3 * pixel);
                        }
                      });
#else
  HWY_ALIGN float numbers[kRowProducts * kRowWinogradChannels];
  const std::ptrdiff_t step = 2 * static_cast<std::ptrdiff_t>(channels);
  for (int pair = 0; pair < pairs; ++pair, pixels += step, out += step) {
    transform_to_floats(pixels, 1, channels, numbers);
    Bfloat16Operand::narrow(numbers, kRowProducts * channels, out);
  }
#endif
}

// Whether two words of a pixel are taken at a time: every other lane holds the second one's sum,
// and two vectors 16 columns. A word that is read serves two products then; one each is more than
// the processor can read.
template <int NV, class D>
constexpr bool kByTwo = HWY_TARGET == HWY_AVX3&& NV == 1 && sizeof(hn::Vec<D>) == 64;

// The word at `at` in every lane, or it and the next one by turns.
template <bool kTwo, class D>
HWY_INLINE hn::Vec<D> words_at(D d, const float* at) {
  if constexpr (kTwo) {
    const hn::Repartition<double, D> dd;
    double both = 0;
    std::memcpy(&both, at, sizeof(both));
    return hn::BitCast(d, hn::Set(dd, both));
  } else {
    return hn::Set(d, *at);
  }
}

// sums[2i][v] += first * w[0][v] and sums[2i + 1][v] += second * w[1][v], over the words of one
// kernel row of pair i: two of its four products.
template <class Operand, bool kTwo, int kRows, int NV, class D>
HWY_INLINE void accumulate_products(D d, const float* pairs, std::ptrdiff_t pixel, const float* w,
                                    hn::Vec<D> (&sums)[kRows][NV]) {
  for (std::ptrdiff_t k = 0; k < pixel; k += kTwo ? 2 : 1, w += kLanes * 2 * NV) {
    const float* at = pairs + k;
    LCDM_UNROLL for (int m = 0; m < kRows; m += 2, at += kRowProducts * pixel) {
      const auto first = words_at<kTwo>(d, at);
      const auto second = words_at<kTwo>(d, at + pixel);
      LCDM_UNROLL for (int v = 0; v < NV; ++v) {
        sums[m][v] = Operand::dot(d, first, hn::LoadU(d, w + v * kLanes), sums[m][v]);
        sums[m + 1][v] =
            Operand::dot(d, second, hn::LoadU(d, w + (NV + v) * kLanes), sums[m + 1][v]);
      }
    }
  }
}

#if HWY_TARGET == HWY_AVX3
// Both words' sums together.
HWY_INLINE FullVec sum_of_two(FullTag d, const FullVec (&sums)[2]) {
  return hn::Add(hn::ConcatEven(d, sums[1], sums[0]), hn::ConcatOdd(d, sums[1], sums[0]));
}
#endif

// acc = bias and the products of all runs of rows from `row`, an even one, on. `words` are the
// panel's.
template <class Operand, int MR, int NV, class D>
HWY_INLINE void multiply_transformed(D d, const RowInput& rows, int row, const float* words,
                                     const float* bias, hn::Vec<D> (&acc)[MR][NV]) {
  constexpr int kRows = MR + MR % 2;
  constexpr bool kTwo = kByTwo<NV, D>;
  constexpr int kVectors = kTwo ? 2 * NV : NV;
  const std::ptrdiff_t pixel = rows.run_length / kRowProducts;
  const std::ptrdiff_t run_words = 2 * pixel * NV * static_cast<std::ptrdiff_t>(kLanes);
  const std::ptrdiff_t first = row * rows.stride;
  hn::Vec<D> sums[kRows][kVectors];
  LCDM_UNROLL for (int m = 0; m < kRows; ++m) {
    LCDM_UNROLL for (int v = 0; v < kVectors; ++v) sums[m][v] = hn::Zero(d);
  }
  for (int r = 0; r < 3; ++r, words += run_words) {
    accumulate_products<Operand, kTwo>(d, rows.run[r] + first, pixel, words, sums);
  }
  LCDM_UNROLL for (int m = 0; m < kRows; m += 2) {
    LCDM_UNROLL for (int v = 0; v < kVectors; ++v) {
      const auto difference = sums[m + 1][v];
      sums[m + 1][v] = hn::Sub(sums[m][v], difference);
      sums[m][v] = hn::Add(sums[m][v], difference);
    }
  }
  for (int r = 0; r < 3; ++r, words += run_words) {
    accumulate_products<Operand, kTwo>(d, rows.run[r] + first + 2 * pixel, pixel, words, sums);
  }
  LCDM_UNROLL for (int m = 0; m < MR; ++m) {
    LCDM_UNROLL for (int v = 0; v < NV; ++v) {
      const auto b = hn::LoadU(d, bias + v * kLanes);
      if constexpr (kTwo) {
        acc[m][v] = hn::Add(b, sum_of_two(d, sums[m]));
      } else {
        acc[m][v] = hn::Add(b, sums[m][v]);
      }
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#endif
