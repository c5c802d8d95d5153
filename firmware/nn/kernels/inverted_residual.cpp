#include "firmware/nn/kernels/inverted_residual.h"

#include <algorithm>
#include <bit>
#include <cstdint>
#include <cstring>

#include "firmware/nn/kernels/words.h"

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "firmware/nn/kernels/inverted_residual.cpp"
#include "firmware/base/simd.h"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
#include "firmware/nn/kernels/bfloat16-inl.h"
#include "firmware/nn/kernels/math-inl.h"
#include "firmware/nn/kernels/own_rows.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

// Pairs of taps that a pair of pixels (2j, 2j + 1) meets, of a kernel row w0, w1, w2; "0" is no
// tap.
enum TapPair : std::uint8_t { k0And0th, k1stAnd2nd, k0thAnd1st, k2ndAnd0, kTapPairs };

// One strip: output columns [first, first + columns), with its ring of three expanded rows, each
// with the padding it needs, and one row of filtered pixels. kPairs: the ring's words are two
// neighbouring pixels each, of which the first has an even column in the image, as `first` has
// where the stride is 1.
template <bool kPairs>
class Strip {
 public:
  HWY_INLINE Strip(const InvertedResidual& block, int first, int columns, float* scratch)
      : b_(block),
        first_(first),
        columns_(columns),
        left_(first * block.stride - kBefore),
        window_(block.window_words(columns)),
        ring_(scratch),
        filtered_(scratch + 3 * row_floats()) {}

  HWY_INLINE void compute_rows(int begin, int end) {
    own_ = OwnRows{begin, end}.of_input(b_.stride);
    int loaded = own_.begin - 1;  // the next row to expand
    for (int y = begin; y < end; ++y) {
      const int top = y * b_.stride - 1;
      for (; loaded <= top + 2; ++loaded) expand_row(loaded);
      if (kPairs || b_.expand.precision != Precision::kFloat32) {
        filter_row<true>(top);
      } else if constexpr (!kPairs) {
        filter_row<false>(top);
      }
      project_row(y);
    }
  }

 private:
  static constexpr int kOfWord = kPairs ? 2 : 1;  // pixels
  static constexpr int kBefore = kOfWord;         // those of the ring before the strip's first one

  std::size_t hidden() const { return static_cast<std::size_t>(b_.hidden); }
  std::size_t row_floats() const { return static_cast<std::size_t>(window_) * hidden(); }
  float* slot(int row) const {
    return ring_ + static_cast<std::size_t>((row + 1) % 3) * row_floats();
  }

  HWY_INLINE void expand_row(int row) {
    float* out = slot(row);
    if (row < 0 || row >= b_.height) {
      std::memset(out, 0, row_floats() * sizeof(float));
      return;
    }
    const int begin = std::max(left_, 0);
    const int end = std::min(left_ + window_ * kOfWord, b_.width);
    float* first = out + static_cast<std::size_t>((begin - left_) / kOfWord) * hidden();
    std::memset(out, 0, static_cast<std::size_t>(first - out) * sizeof(float));
    const std::size_t pixel = static_cast<std::size_t>(row) * b_.width + begin;
    const RowInput pixels = {
        {b_.input + pixel * b_.channels}, 1, b_.channels, b_.channels, end - begin};
    multiply_rows(pixels, b_.expand, {first, nullptr, b_.hidden, Activation::kSilu, kPairs});
    const int words = (end - begin + kOfWord - 1) / kOfWord;
    float* last = first + static_cast<std::size_t>(words) * hidden();
    std::memset(last, 0, static_cast<std::size_t>(out + row_floats() - last) * sizeof(float));
    if (b_.expanded != nullptr && own_.has(row)) {
      keep_expanded(first, end - begin, b_.expanded + pixel * hidden());
    }
  }

  HWY_INLINE void keep_expanded(const float* words, int pixels, float* out) const {
    const std::size_t count = static_cast<std::size_t>(pixels) * hidden();
    if constexpr (!kPairs) {
      std::copy_n(words, count, out);
    } else {
      for (std::size_t i = 0; i < count; ++i) {
        const std::size_t pixel = i / hidden();
        const auto bits = std::bit_cast<std::uint32_t>(words[pixel / 2 * hidden() + i % hidden()]);
        out[i] = pixel % 2 == 0 ? bfloat16_first(bits) : bfloat16_second(bits);
      }
    }
  }

  // kPixels neighbouring pixels, the first at `column` of the strip, an even one where it counts.
  // Columns that windows share are loaded once.
  template <bool kRough, std::size_t kStride, std::size_t kPixels>
  HWY_INLINE void filter_pixels(const float* const (&rows)[3], std::size_t column) {
    const std::size_t pitch = hidden();
    float* out = filtered_ + column * pitch;
    for_channels(pitch, [&](auto d, std::size_t c) HWY_ATTR {
      hn::Vec<decltype(d)> sum[kPixels];
      LCDM_UNROLL for (auto& v : sum) v = hn::LoadU(d, b_.taps_bias + c);
      if constexpr (kPairs) {
        add_pairs<kStride>(d, rows, column, c, sum);
      } else {
        add_pixels<kStride>(d, rows, column, c, sum);
      }
      LCDM_UNROLL for (std::size_t p = 0; p < kPixels; ++p) {
        hn::StoreU(activate<Activation::kSilu, kRough>(d, sum[p]), d, out + p * pitch + c);
      }
    });
  }

  template <std::size_t kStride, std::size_t kPixels, class D>
  HWY_INLINE void add_pixels(D d, const float* const (&rows)[3], std::size_t column, std::size_t c,
                             hn::Vec<D> (&sum)[kPixels]) const {
    constexpr std::size_t kColumns = (kPixels - 1) * kStride + 3;
    const std::size_t pitch = hidden();
    const std::size_t at = column * kStride * pitch + c;
    LCDM_UNROLL for (std::size_t ky = 0; ky < 3; ++ky) {
      hn::Vec<D> pixel[kColumns];
      LCDM_UNROLL for (std::size_t i = 0; i < kColumns; ++i) {
        pixel[i] = hn::LoadU(d, rows[ky] + at + i * pitch);
      }
      LCDM_UNROLL for (std::size_t kx = 0; kx < 3; ++kx) {
        const auto w = hn::LoadU(d, b_.taps + (ky * 3 + kx) * pitch + c);
        LCDM_UNROLL for (std::size_t p = 0; p < kPixels; ++p) {
          sum[p] = hn::MulAdd(pixel[p * kStride + kx], w, sum[p]);
        }
      }
    }
  }

  // Two products with a pair each where three with one pixel each were.
  template <std::size_t kStride, std::size_t kPixels, class D>
  HWY_INLINE void add_pairs(D d, const float* const (&rows)[3], std::size_t column, std::size_t c,
                            hn::Vec<D> (&sum)[kPixels]) const {
    using Operand = Bfloat16Operand;
    constexpr std::size_t kWords = kStride == 1 ? kPixels / 2 + 2 : kPixels + 1;
    const std::size_t pitch = hidden();
    const std::size_t at = (kStride == 1 ? column / 2 : column) * pitch + c;
    LCDM_UNROLL for (std::size_t ky = 0; ky < 3; ++ky) {
      hn::Vec<D> word[kWords];
      LCDM_UNROLL for (std::size_t i = 0; i < kWords; ++i) {
        word[i] = hn::LoadU(d, rows[ky] + at + i * pitch);
      }
      const float* taps = b_.taps + ky * kTapPairs * pitch + c;
      const auto pair = [&](TapPair which) HWY_ATTR { return hn::LoadU(d, taps + which * pitch); };
      LCDM_UNROLL for (std::size_t p = 0; p < kPixels; ++p) {
        if (kStride == 2 || p % 2 == 0) {
          const std::size_t i = kStride == 2 ? p : p / 2;
          sum[p] = Operand::dot(d, word[i], pair(k0And0th), sum[p]);
          sum[p] = Operand::dot(d, word[i + 1], pair(k1stAnd2nd), sum[p]);
        } else {
          const std::size_t i = (p + 1) / 2;
          sum[p] = Operand::dot(d, word[i], pair(k0thAnd1st), sum[p]);
          sum[p] = Operand::dot(d, word[i + 1], pair(k2ndAnd0), sum[p]);
        }
      }
    }
  }

  template <bool kRough, std::size_t kStride>
  HWY_INLINE void filter_row(int top) {
    constexpr std::size_t kPixels = 4;
    const float* const rows[3] = {slot(top), slot(top + 1), slot(top + 2)};
    const auto columns = static_cast<std::size_t>(columns_);
    std::size_t x = 0;
    if constexpr (HWY_TARGET == HWY_AVX3) {  // 32 registers
      for (; x + 8 <= columns; x += 8) filter_pixels<kRough, kStride, 8>(rows, x);
    }
    for (; x + kPixels <= columns; x += kPixels) filter_pixels<kRough, kStride, kPixels>(rows, x);
    for (; x + 2 <= columns; x += 2) filter_pixels<kRough, kStride, 2>(rows, x);
    if (x < columns) filter_pixels<kRough, kStride, 1>(rows, x);
  }

  template <bool kRough>
  HWY_INLINE void filter_row(int top) {
    if (b_.stride == 1) {
      filter_row<kRough, 1>(top);
    } else {
      filter_row<kRough, 2>(top);
    }
  }

  HWY_INLINE void project_row(int y) {
    const std::size_t pixel = static_cast<std::size_t>(y) * (b_.width / b_.stride) + first_;
    if (b_.filtered != nullptr) {
      std::copy_n(filtered_, static_cast<std::size_t>(columns_) * hidden(),
                  b_.filtered + pixel * hidden());
    }
    const std::size_t at = pixel * b_.project.columns;
    const float* residual = b_.residual != nullptr ? b_.residual + at : nullptr;
    multiply_rows({{filtered_}, 1, b_.hidden, b_.hidden, columns_}, b_.project,
                  {b_.output + at, residual, b_.project.columns, Activation::kNone});
  }

  const InvertedResidual& b_;
  int first_;
  int columns_;
  int left_;     // column of the input under the ring's first pixel
  int window_;   // words of a ring row, for each channel
  OwnRows own_;  // of the input
  float* ring_;
  float* filtered_;
};

void rows(const InvertedResidual& b, int begin, int end, float* scratch) {
  const int out_width = b.width / b.stride;
  const int step = b.strip_columns();
  for (int first = 0; first < out_width; first += step) {
    const int columns = std::min(step, out_width - first);
    if (b.filter == Precision::kFloat32) {
      Strip<false>(b, first, columns, scratch).compute_rows(begin, end);
    } else {
      Strip<true>(b, first, columns, scratch).compute_rows(begin, end);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm::kernels {

HWY_EXPORT(rows);

int InvertedResidual::strip_columns() const {
  // A strip's three rows must stay in the second cache beside the weights, also where that has
  // 256 KB.
  constexpr int kRingFloats = (160 << 10) / static_cast<int>(sizeof(float));
  const int words = kRingFloats / 3 / hidden - 2;
  const int most = std::max(8, width / stride);
  if (filter == Precision::kFloat32) return std::clamp(words / stride, 8, most);
  // Pairs take half of that; the rest is for a longer row of filtered pixels. An even number.
  return std::clamp(words / stride * 3 / 2 / 2 * 2, 8, most);
}

int InvertedResidual::window_words(int columns) const {
  const int last = (columns - 1) * stride + 1;  // pixel after the first one under a window's middle
  return filter == Precision::kFloat32 ? last + 2 : last / 2 + 2;
}

std::vector<float> pack_filter_taps(std::span<const float> taps, Precision filter) {
  if (filter == Precision::kFloat32) return {taps.begin(), taps.end()};
  constexpr int kNone = 3;
  constexpr int kTapsOf[][2] = {{kNone, 0}, {1, 2}, {0, 1}, {2, kNone}};  // as TapPair
  const std::size_t hidden = taps.size() / 9;
  std::vector<float> out;
  for (std::size_t row = 0; row < taps.size(); row += 3 * hidden) {
    for (const auto& pair : kTapsOf) {
      for (std::size_t c = row; c < row + hidden; ++c) {
        const auto tap = [&](int k) {
          return k == kNone ? 0.0F : taps[c + static_cast<std::size_t>(k) * hidden];
        };
        out.push_back(std::bit_cast<float>(bfloat16_pair(tap(pair[0]), tap(pair[1]))));
      }
    }
  }
  return out;
}

std::size_t inverted_residual_scratch(const InvertedResidual& b) {
  const int columns = b.strip_columns();
  return static_cast<std::size_t>(3 * b.window_words(columns) + columns) *
         static_cast<std::size_t>(b.hidden);
}

void inverted_residual_rows(const InvertedResidual& b, int begin, int end, float* scratch) {
  HWY_DYNAMIC_DISPATCH(rows)(b, begin, end, scratch);
}

}  // namespace lcdm::kernels
#endif  // HWY_ONCE
