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

// What the three taps of a direction give at one low-resolution place.
template <class V>
struct OfTaps {
  V tap[3];
};

// What both upsampled places over one low-resolution place get.
template <class V>
struct Doubled {
  V first;
  V second;
};

// From the places before it, there and after it: away from the borders.
template <class D, class V = hn::Vec<D>>
HWY_INLINE Doubled<V> doubled(D d, const OfTaps<V>& before, const OfTaps<V>& here,
                              const OfTaps<V>& after) {
  const V most = hn::Set(d, 0.75F);
  const V least = hn::Set(d, 0.25F);
  const V near_first = hn::Add(hn::Add(before.tap[0], here.tap[1]), here.tap[2]);
  const V far_first = hn::Add(hn::Add(before.tap[1], here.tap[0]), after.tap[2]);
  const V near_second = hn::Add(hn::Add(here.tap[0], here.tap[1]), after.tap[2]);
  const V far_second = hn::Add(hn::Add(after.tap[1], here.tap[2]), before.tap[0]);
  return {hn::MulAdd(most, near_first, hn::Mul(least, far_first)),
          hn::MulAdd(most, near_second, hn::Mul(least, far_second))};
}

// The same anywhere: place i of `size`. What is beyond the border has no weight, but is finite.
template <class D, class V = hn::Vec<D>>
HWY_NOINLINE Doubled<V> doubled_at(D d, int i, int size, const OfTaps<V>& before,
                                   const OfTaps<V>& here, const OfTaps<V>& after) {
  const OfTaps<V>* const places[3] = {&before, &here, &after};
  const auto sum = [&](const TapWeights& weights) HWY_ATTR {
    V out = hn::Zero(d);
    for (std::size_t tap = 0; tap < 3; ++tap) {
      for (std::size_t near = 0; near < 3; ++near) {
        out = hn::MulAdd(hn::Set(d, weights.of[tap][near]), places[near]->tap[tap], out);
      }
    }
    return out;
  };
  return {sum(tap_weights(2 * i, size)), sum(tap_weights(2 * i + 1, size))};
}

// Rows of the upsampled share, two by two and in order: what they are made of is read once for
// both. Scratch: UpsampledShare::scratch_floats.
class UpsampledRows {
 public:
  // Row `first` is in the first pair that will be asked for.
  HWY_INLINE void begin(const UpsampledShare& share, int first, float* scratch) {
    s_ = share;
    columns_ = static_cast<std::size_t>(share.taps.columns) / 9;
    ring_ = scratch;
    next_ = first / 2 - 1;
  }

  // Output rows 2i and 2i + 1, [2 * width, columns] each.
  HWY_INLINE void pair(int i, float* even, float* odd) {
    for (const int last = std::min(i + 1, s_.height - 1); next_ <= last; ++next_) {
      if (next_ >= 0) convolve(next_);
    }
    const bool border = i == 0 || i + 1 == s_.height;
    for_channels(columns_, [&](auto d, std::size_t c) HWY_ATTR {
      if (border) {
        columns<true>(d, i, even + c, odd + c, c);
      } else {
        columns<false>(d, i, even + c, odd + c, c);
      }
    });
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

  // What the three tap columns of both rows give at one place.
  template <class V>
  struct BothRows {
    OfTaps<V> even;
    OfTaps<V> odd;
  };

  // Of place x and a vector of columns from c on.
  template <bool kBorder, class D, class V = hn::Vec<D>>
  HWY_INLINE BothRows<V> of_place(D d, int i, std::size_t x, std::size_t c) const {
    const auto place = [&](int row) {
      return slot(std::clamp(row, 0, s_.height - 1)) + x * 9 * columns_ + c;
    };
    const float* const from[3] = {place(i - 1), place(i), place(i + 1)};
    const auto column = [&](std::size_t kx) HWY_ATTR {
      const auto of_row = [&](std::size_t near) HWY_ATTR {
        const float* tap = from[near] + kx * columns_;
        return OfTaps<V>{hn::LoadU(d, tap), hn::LoadU(d, tap + 3 * columns_),
                         hn::LoadU(d, tap + 6 * columns_)};
      };
      const OfTaps<V> above = of_row(0);
      const OfTaps<V> here = of_row(1);
      const OfTaps<V> below = of_row(2);
      return kBorder ? doubled_at(d, i, s_.height, above, here, below)
                     : doubled(d, above, here, below);
    };
    const Doubled<V> first = column(0);
    const Doubled<V> second = column(1);
    const Doubled<V> third = column(2);
    return {{{first.first, second.first, third.first}},
            {{first.second, second.second, third.second}}};
  }

  // All pixels of both rows, a vector of columns from c on.
  template <bool kBorder, class D, class V = hn::Vec<D>>
  HWY_INLINE void columns(D d, int i, float* even, float* odd, std::size_t c) const {
    BothRows<V> here = of_place<kBorder>(d, i, 0, c);
    BothRows<V> left = here;
    for (std::size_t x = 0; x < width(); ++x) {
      const bool last = x + 1 == width();
      const BothRows<V> right = last ? here : of_place<kBorder>(d, i, x + 1, c);
      const auto store = [&](const OfTaps<V>& before, const OfTaps<V>& at, const OfTaps<V>& after,
                             float* out) HWY_ATTR {
        const Doubled<V> pixels =
            x == 0 || last ? doubled_at(d, static_cast<int>(x), s_.width, before, at, after)
                           : doubled(d, before, at, after);
        hn::StoreU(pixels.first, d, out + 2 * x * columns_);
        hn::StoreU(pixels.second, d, out + (2 * x + 1) * columns_);
      };
      store(left.even, here.even, right.even, even);
      store(left.odd, here.odd, right.odd, odd);
      left = here;
      here = right;
    }
  }

  UpsampledShare s_;
  std::size_t columns_ = 0;  // of the convolution
  float* ring_ = nullptr;    // three rows of products
  int next_ = 0;             // low-resolution row to convolve next
};

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#endif
