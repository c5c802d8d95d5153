// What a bilinearly upsampled input adds to one row of a 3x3 convolution with zero padding.
//
// Upsampling and convolution are both linear, so their order can change: nine 1x1 convolutions at
// the low resolution, one for each tap, then for each output row the sum of their shifted and
// upsampled results. That is a quarter of the multiplications, and the upsampled image never
// exists. Exact, borders included: taps beyond the image have no part in the sums.
#if defined(LCDM_KERNELS_UPSAMPLED_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef LCDM_KERNELS_UPSAMPLED_INL_H
#undef LCDM_KERNELS_UPSAMPLED_INL_H
#else
#define LCDM_KERNELS_UPSAMPLED_INL_H
#endif

#include <algorithm>
#include <cstddef>

#include "firmware/nn/kernels/conv.h"
#include "firmware/nn/kernels/math-inl.h"

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

// How much of the low-resolution pixels i - 1, i and i + 1 the three taps around upsampled pixel
// 2i + phase see: of[tap][pixel - (i - 1)].
struct TapWeights {
  float of[3][3] = {};
};

HWY_INLINE TapWeights tap_weights(int at, int size) {
  TapWeights weights;
  const int i = at / 2;
  for (int tap = 0; tap < 3; ++tap) {
    const int seen = at + tap - 1;
    if (seen < 0 || seen >= 2 * size) continue;  // the convolution's padding
    const int near = seen / 2;
    const int far = std::clamp(seen % 2 == 0 ? near - 1 : near + 1, 0, size - 1);
    weights.of[tap][near - i + 1] += 0.75F;
    weights.of[tap][far - i + 1] += 0.25F;
  }
  return weights;
}

// Rows of the upsampled share, in order. Scratch: UpsampledShare::scratch_floats.
class UpsampledRows {
 public:
  // `first` is the first row that will be asked for.
  HWY_INLINE void begin(const UpsampledShare& share, int first, float* scratch) {
    s_ = share;
    columns_ = static_cast<std::size_t>(share.taps.columns) / 9;
    ring_ = scratch;
    sums_ = ring_ + 3 * row_floats();
    next_ = first / 2 - 1;
  }

  // Output row y, [2 * width, columns], into `out`.
  HWY_INLINE void row(int y, float* out) {
    for (const int last = std::min(y / 2 + 1, s_.height - 1); next_ <= last; ++next_) {
      if (next_ >= 0) convolve(next_);
    }
    add_vertically(y);
    add_horizontally(out);
  }

 private:
  std::size_t width() const { return static_cast<std::size_t>(s_.width); }
  std::size_t row_floats() const { return width() * 9 * columns_; }
  float* slot(int row) const {
    return ring_ + static_cast<std::size_t>((row + 3) % 3) * row_floats();
  }

  // All nine taps' products with low-resolution row `row`: [width, tap, columns].
  HWY_INLINE void convolve(int row) {
    const RowInput pixels = {{s_.data + static_cast<std::size_t>(row) * width() * s_.channels},
                             1,
                             s_.channels,
                             s_.channels,
                             s_.width};
    multiply_rows(pixels, s_.taps, {slot(row), nullptr, s_.taps.columns, Activation::kNone});
  }

  // sums_[x][tap column][c]: the taps' rows with their weights.
  HWY_INLINE void add_vertically(int y) {
    struct Term {
      const float* from;
      float weight;
    };
    Term terms[6];
    int count = 0;
    const TapWeights weights = tap_weights(y, s_.height);
    const std::size_t pitch = 3 * columns_;
    for (int tap = 0; tap < 3; ++tap) {
      for (int near = 0; near < 3; ++near) {
        const float weight = weights.of[tap][near];
        if (weight > 0) terms[count++] = {slot(y / 2 + near - 1) + tap * pitch, weight};
      }
    }
    for (; count < 6; ++count) terms[count] = {terms[0].from, 0.0F};
    for (std::size_t x = 0; x < width(); ++x) {
      for_channels(pitch, [&](auto d, std::size_t c) HWY_ATTR {
        const std::size_t at = 3 * x * pitch + c;
        auto sum = hn::Mul(hn::Set(d, terms[0].weight), hn::LoadU(d, terms[0].from + at));
        LCDM_UNROLL for (int t = 1; t < 6; ++t) {
          sum = hn::MulAdd(hn::Set(d, terms[t].weight), hn::LoadU(d, terms[t].from + at), sum);
        }
        hn::StoreU(sum, d, sums_ + x * pitch + c);
      });
    }
  }

  HWY_INLINE void add_horizontally(float* out) {
    for (std::size_t x = 0; x < width(); ++x) {
      if (x == 0 || x + 1 == width()) {
        border_pixel(2 * x, out);
        border_pixel(2 * x + 1, out);
      } else {
        pixel_pair(x, out + 2 * x * columns_);
      }
    }
  }

  HWY_INLINE void border_pixel(std::size_t x, float* out) {
    const TapWeights weights = tap_weights(static_cast<int>(x), s_.width);
    for_channels(columns_, [&](auto d, std::size_t c) HWY_ATTR {
      auto sum = hn::Zero(d);
      for (std::size_t tap = 0; tap < 3; ++tap) {
        for (std::size_t near = 0; near < 3; ++near) {
          const float weight = weights.of[tap][near];
          if (weight == 0) continue;
          const float* from = sums_ + ((x / 2 + near - 1) * 3 + tap) * columns_ + c;
          sum = hn::MulAdd(hn::Set(d, weight), hn::LoadU(d, from), sum);
        }
      }
      hn::StoreU(sum, d, out + x * columns_ + c);
    });
  }

  // Both output pixels over low-resolution column x, away from the borders.
  HWY_INLINE void pixel_pair(std::size_t x, float* out) {
    const std::size_t n = columns_;
    for_channels(n, [&](auto d, std::size_t c) HWY_ATTR {
      const auto most = hn::Set(d, 0.75F);
      const auto least = hn::Set(d, 0.25F);
      const float* here = sums_ + 3 * x * n + c;
      const float* left = here - 3 * n;
      const float* right = here + 3 * n;
      const auto here0 = hn::LoadU(d, here);
      const auto here1 = hn::LoadU(d, here + n);
      const auto here2 = hn::LoadU(d, here + 2 * n);
      const auto left0 = hn::LoadU(d, left);
      const auto right2 = hn::LoadU(d, right + 2 * n);
      auto even = hn::MulAdd(most, left0, hn::Mul(least, hn::LoadU(d, left + n)));
      even = hn::MulAdd(least, hn::Add(here0, right2), even);
      even = hn::MulAdd(most, hn::Add(here1, here2), even);
      auto odd = hn::MulAdd(most, right2, hn::Mul(least, hn::LoadU(d, right + n)));
      odd = hn::MulAdd(least, hn::Add(here2, left0), odd);
      odd = hn::MulAdd(most, hn::Add(here0, here1), odd);
      hn::StoreU(even, d, out + c);
      hn::StoreU(odd, d, out + n + c);
    });
  }

  UpsampledShare s_;
  std::size_t columns_ = 0;  // of the convolution
  float* ring_ = nullptr;    // three rows of products
  float* sums_ = nullptr;    // [width, 3, columns]
  int next_ = 0;             // low-resolution row to convolve next
};

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#endif
