// The head's hidden layer and update in pairs of halves.
#if defined(LCDM_KERNELS_HEAD_PAIRS_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef LCDM_KERNELS_HEAD_PAIRS_INL_H
#undef LCDM_KERNELS_HEAD_PAIRS_INL_H
#else
#define LCDM_KERNELS_HEAD_PAIRS_INL_H
#endif

#include <algorithm>
#include <cstddef>
#include <cstring>

#include "firmware/nn/kernels/bfloat16-inl.h"
#include "firmware/nn/kernels/head.h"
#include "firmware/nn/kernels/head_floats-inl.h"
#include "firmware/nn/kernels/math-inl.h"
#include "firmware/nn/kernels/own_rows.h"

#include "hwy/cache_control.h"

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

// As the floats, where one pixel's channels are one vector: twice the multiply-adds in an
// instruction, and half the bytes of the hidden layer and of what it is made of.
class HeadPairs {
 public:
  using Operand = Bfloat16Operand;
  // Words of a pixel of the hidden layer; a vector holds two pixels.
  static constexpr std::size_t kPixel = kLanes > 1 ? kLanes / 2 : 1;

  // Pixels of a row in whole vectors of outputs.
  static std::size_t padded_width(const HeadUpdate& u) {
    return (static_cast<std::size_t>(u.step.width) + kLanes - 1) / kLanes * kLanes;
  }
  static std::size_t hidden_words(const HeadUpdate& u) { return (padded_width(u) + 2) * kPixel; }
  // Two numbers before the first, and what vectors write beyond the last.
  static std::size_t state_words(const HeadUpdate& u) { return padded_width(u) + kLanes; }
  static std::size_t padded_state(const HeadUpdate& u) { return state_words(u) + kLanes; }
  static std::size_t scratch_floats(const HeadUpdate& u) {
    return 3 * hidden_words(u) + 5 * state_words(u) + padded_state(u);
  }

  HWY_INLINE HeadPairs(const HeadUpdate& u, const OwnRows& own, float* scratch)
      : u_(u),
        s_(u.step),
        own_(own),
        width_(static_cast<std::size_t>(u.step.width)),
        hidden_(scratch),
        states_(hidden_ + 3 * hidden_words(u)),
        state_(states_ + 5 * state_words(u)),
        loaded_(own.begin - 1),
        next_state_(own.begin - 3) {
    std::memset(scratch, 0, scratch_floats(u) * sizeof(float));  // the padding
  }

  HWY_INLINE void compute() {
    for (int y = own_.begin; y < own_.end; ++y) {
      for (; loaded_ <= y + 1; ++loaded_) load(loaded_);
      update_row(y);
    }
  }

 private:
  float* hidden_slot(int row) const {
    return hidden_ + static_cast<std::size_t>((row + 1) % 3) * hidden_words(u_);
  }
  float* state_slot(int row) const {
    return states_ + static_cast<std::size_t>(row % 5) * state_words(u_);
  }

  // Row y of the hidden layer, all zero beyond the image, and what it needs of the state.
  HWY_INLINE void load(int y) {
    float* out = hidden_slot(y);
    if (y < 0 || y >= s_.height) {
      std::memset(out, 0, hidden_words(u_) * sizeof(float));
      return;
    }
    for (; next_state_ <= std::min(y + 2, s_.height - 1); ++next_state_) {
      if (s_.state != nullptr && next_state_ >= 0) load_state(next_state_);
    }
    hidden_row(y, out + kPixel);
  }

  // A row of the state as words of two neighbours each, the first of them both before the image.
  HWY_INLINE void load_state(int y) {
    const FullTag d;
    std::memcpy(state_ + 2, s_.state + static_cast<std::size_t>(y) * width_,
                width_ * sizeof(float));
    float* words = state_slot(y);
    for (std::size_t i = 0; i < state_words(u_); i += kLanes) {
      const FullVec pairs =
          Operand::pair(d, hn::LoadU(d, state_ + i), hn::LoadU(d, state_ + i + 1));
      hn::StoreU(pairs, d, words + i);
    }
  }

  // Both pixels of a word.
  struct Both {
    FullVec first;
    FullVec second;
  };
  static HWY_INLINE Both pixels_of(FullVec words) {
    const FullTag d;
    const hn::RebindToUnsigned<FullTag> du;
    const auto bits = hn::BitCast(du, words);
    return {hn::BitCast(d, hn::ShiftLeft<16>(bits)),
            hn::BitCast(d, hn::And(bits, hn::Set(du, 0xFFFF0000U)))};
  }

  // kPixels neighbours of one place, from an even one on where they are more than one.
  template <std::size_t kPixels>
  HWY_INLINE void hidden_pixels(int y, std::size_t x, std::size_t place, float* out) {
    const FullTag d;
    const FullVec scale = hn::LoadU(d, s_.scale);
    const FullVec constant = hn::LoadU(d, s_.constant + place * kLanes);
    const float* shared =
        s_.shared + (static_cast<std::size_t>(y) * ((width_ + 1) / 2) + x / 2) * kLanes;
    FullVec h[kPixels];
    LCDM_UNROLL for (std::size_t i = 0; i < kPixels; i += 2, shared += kLanes) {
      hwy::Prefetch(shared + kAhead);
      const Both both = pixels_of(hn::LoadU(d, shared));
      if constexpr (kPixels == 1) {
        h[0] = hn::MulAdd(scale, x % 2 == 0 ? both.first : both.second, constant);
      } else {
        h[i] = hn::MulAdd(scale, both.first, constant);
        h[i + 1] = hn::MulAdd(scale, both.second, constant);
      }
    }
    const int first_row = std::max(y - 2, 0);
    const int last_row = std::min(y + 2, s_.height - 1);
    for (int row = first_row; row <= last_row && s_.state != nullptr; ++row) {
      const std::size_t taps = place * 15 + 3 * static_cast<std::size_t>(row - y + 2);
      add_state(state_slot(row) + x, s_.composed + taps * kLanes, h);
    }
    LCDM_UNROLL for (std::size_t i = 0; i < kPixels; ++i) {
      if (s_.relu) h[i] = rectified(d, h[i]);
      if (s_.hidden == nullptr || !own_.has(y)) continue;
      hn::StoreU(h[i], d, s_.hidden + (static_cast<std::size_t>(y) * width_ + x + i) * kLanes);
    }
    store(h, out + x * kPixel);
  }

  // A row of taps: three words, of which each pixel sees the first and every second after it.
  template <std::size_t kPixels>
  HWY_INLINE void add_state(const float* words, const float* taps, FullVec (&h)[kPixels]) {
    const FullTag d;
    const FullVec w[3] = {hn::LoadU(d, taps), hn::LoadU(d, taps + kLanes),
                          hn::LoadU(d, taps + 2 * kLanes)};
    LCDM_UNROLL for (std::size_t column = 0; column < kPixels + 4; ++column) {
      const FullVec x = hn::Set(d, words[column]);
      LCDM_UNROLL for (std::size_t t = 0; t < 3; ++t) {
        const std::size_t i = column - 2 * t;  // beyond kPixels where it would be negative
        if (i < kPixels) h[i] = Operand::dot(d, x, w[t], h[i]);
      }
    }
  }

  template <std::size_t kPixels>
  HWY_INLINE void store(const FullVec (&h)[kPixels], float* out) {
    const FullTag d;
    if constexpr (kPixels == 1) {
      HWY_ALIGN float both[kLanes];
      hn::Store(Operand::joined(d, h[0], h[0]), d, both);
      std::memcpy(out, both, kPixel * sizeof(float));
    } else {
      LCDM_UNROLL for (std::size_t i = 0; i < kPixels; i += 2) {
        hn::StoreU(Operand::joined(d, h[i], h[i + 1]), d, out + i * kPixel);
      }
    }
  }

  HWY_INLINE void hidden_row(int y, float* out) {
    const std::size_t row = 3 * place_along(y, s_.height);
    const auto single = [&](std::size_t x) HWY_ATTR {
      hidden_pixels<1>(y, x, row + place_along(static_cast<int>(x), s_.width), out);
    };
    single(0);
    single(1);
    std::size_t x = 2;
    for (; x + 8 < width_; x += 8) hidden_pixels<8>(y, x, row + 1, out);
    for (; x + 2 < width_; x += 2) hidden_pixels<2>(y, x, row + 1, out);
    for (; x < width_; ++x) single(x);
  }

  // conv3x3 at kLanes pixels from x on: a vector of sums is of two neighbours.
  HWY_INLINE FullVec convolve(const float* const (&rows)[3], std::size_t x) const {
    const FullTag d;
    FullVec sum[kPixel];
    LCDM_UNROLL for (FullVec& v : sum) v = hn::Zero(d);
    LCDM_UNROLL for (std::size_t ky = 0; ky < 3; ++ky) {
      LCDM_UNROLL for (std::size_t kx = 0; kx < 3; ++kx) {
        const FullVec w = hn::LoadU(d, u_.weights + (3 * ky + kx) * kLanes);
        const float* from = rows[ky] + (x + kx) * kPixel;
        LCDM_UNROLL for (std::size_t i = 0; i < kPixel; ++i) {
          sum[i] = Operand::dot(d, hn::LoadU(d, from + 2 * i * kPixel), w, sum[i]);
        }
      }
    }
    return sums_of_lanes(sum);
  }

  HWY_INLINE void update_row(int y) const {
    const FullTag d;
    const float* const rows[3] = {hidden_slot(y - 1), hidden_slot(y), hidden_slot(y + 1)};
    const float* state = u_.state + static_cast<std::size_t>(y) * width_;
    float* next = u_.next + static_cast<std::size_t>(y) * width_;
    const auto updated = [&](std::size_t x, FullVec before) HWY_ATTR {
      const FullVec out = hn::Add(convolve(rows, x), hn::Set(d, u_.bias));
      return hn::MulAdd(hn::Set(d, u_.q), out, hn::Mul(hn::Set(d, u_.p), before));
    };
    std::size_t x = 0;
    for (; x + kLanes <= width_; x += kLanes) {
      hn::StoreU(updated(x, hn::LoadU(d, state + x)), d, next + x);
    }
    if (x == width_) return;
    HWY_ALIGN float part[kLanes] = {};
    std::memcpy(part, state + x, (width_ - x) * sizeof(float));
    hn::Store(updated(x, hn::Load(d, part)), d, part);
    std::memcpy(next + x, part, (width_ - x) * sizeof(float));
  }

  const HeadUpdate& u_;
  const HeadStep& s_;
  OwnRows own_;
  std::size_t width_;
  float* hidden_;   // three rows of the hidden layer, each between two pixels of zeros
  float* states_;   // five rows of the state, each word a number and the next
  float* state_;    // one such row of numbers, between zeros
  int loaded_;      // the row of the hidden layer to make next
  int next_state_;  // of the state
};

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#endif
