#include "firmware/nn/kernels/head.h"

#include <algorithm>
#include <bit>
#include <cstring>
#include <type_traits>

#include "firmware/base/check.h"
#include "firmware/nn/kernels/matrix.h"
#include "firmware/nn/kernels/words.h"

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "firmware/nn/kernels/head.cpp"
#include "firmware/base/simd.h"
#include "hwy/foreach_target.h"
#include "hwy/cache_control.h"
#include "hwy/highway.h"
#include "firmware/nn/kernels/bfloat16-inl.h"
#include "firmware/nn/kernels/math-inl.h"
#include "firmware/nn/kernels/own_rows.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

// Floats from those of `shared` that are used to those that are fetched: 6 KB. Larger pictures'
// come from memory, and are not asked for early enough otherwise.
constexpr std::size_t kAhead = 1536;

// kPixels neighbours of one place; what of the state is beyond the image has no part. kClipped: a
// pixel from which columns of it are.
template <std::size_t kPixels, bool kClipped>
HWY_INLINE void hidden_pixels(const HeadStep& s, int y, int x, std::size_t place, float* out,
                              std::size_t pitch) {
  const auto channels = static_cast<std::size_t>(s.channels);
  const auto width = static_cast<std::size_t>(s.width);
  const std::size_t at = static_cast<std::size_t>(y) * width + static_cast<std::size_t>(x);
  const float* shared = s.shared + at * channels;
  const float* composed = s.composed + place * 25 * channels;
  const int first_row = std::max(y - 2, 0);
  const int last_row = std::min(y + 2, s.height - 1);
  const int first_column = kClipped ? std::max(2 - x, 0) : 0;
  const int end_column = kClipped ? std::min(s.width + 2 - x, 5) : 5;
  for_channels(channels, [&](auto d, std::size_t c) HWY_ATTR {
    using V = decltype(hn::Zero(d));
    const V scale = hn::LoadU(d, s.scale + c);
    const V constant = hn::LoadU(d, s.constant + place * channels + c);
    V h[kPixels];
    LCDM_UNROLL for (std::size_t i = 0; i < kPixels; ++i) {
      const float* from = shared + i * channels + c;
      hwy::Prefetch(from + kAhead);
      h[i] = hn::MulAdd(scale, hn::LoadU(d, from), constant);
    }
    for (int row = first_row; row <= last_row && s.state != nullptr; ++row) {
      const float* state = s.state + static_cast<std::size_t>(row) * width;
      const float* taps = composed + static_cast<std::size_t>(5 * (row - y + 2)) * channels + c;
      LCDM_UNROLL for (int kx = first_column; kx < end_column; ++kx) {
        const V w = hn::LoadU(d, taps + static_cast<std::size_t>(kx) * channels);
        LCDM_UNROLL for (std::size_t i = 0; i < kPixels; ++i) {
          h[i] = hn::MulAdd(hn::Set(d, state[x - 2 + kx + static_cast<int>(i)]), w, h[i]);
        }
      }
    }
    LCDM_UNROLL for (std::size_t i = 0; i < kPixels; ++i) {
      hn::StoreU(s.relu ? hn::Max(h[i], hn::Zero(d)) : h[i], d, out + i * pitch + c);
    }
  });
}

HWY_INLINE std::size_t place_along(int at, int size) {
  if (at == 0) return 0;
  return at == size - 1 ? 2 : 1;
}

// Row y of the hidden layer, `pitch` floats from pixel to pixel.
HWY_INLINE void hidden_row(const HeadStep& s, int y, float* out, std::size_t pitch) {
  constexpr int kBorder = 2;
  constexpr int kPixels = 8;  // sums enough to hide the latency of 25 in a row
  const std::size_t row = 3 * place_along(y, s.height);
  const auto clipped = [&](int x) HWY_ATTR {
    hidden_pixels<1, true>(s, y, x, row + place_along(x, s.width), out + x * pitch, pitch);
  };
  const auto inner = [&](auto pixels, int x) HWY_ATTR {
    hidden_pixels<decltype(pixels)::value, false>(s, y, x, row + 1, out + x * pitch, pitch);
  };
  int x = 0;
  for (; x < kBorder && x < s.width; ++x) clipped(x);
  for (; x + kPixels <= s.width - kBorder; x += kPixels) {
    inner(std::integral_constant<std::size_t, kPixels>(), x);
  }
  for (; x + 4 <= s.width - kBorder; x += 4) inner(std::integral_constant<std::size_t, 4>(), x);
  for (; x < s.width; ++x) clipped(x);
}

void hidden_rows(const HeadStep& s, int begin, int end) {
  const auto channels = static_cast<std::size_t>(s.channels);
  for (int y = begin; y < end; ++y) {
    hidden_row(s, y, s.hidden + static_cast<std::size_t>(y) * s.width * channels, channels);
  }
}

// All lanes of the vectors as one row: lane i of the result is the sum of its i-th kVectors lanes.
template <std::size_t kVectors>
HWY_INLINE FullVec sums_of_lanes(FullVec (&v)[kVectors]) {
#if HWY_TARGET != HWY_SCALAR
  const FullTag d;
  LCDM_UNROLL for (std::size_t n = kVectors / 2; n > 0; n /= 2) {
    LCDM_UNROLL for (std::size_t i = 0; i < n; ++i) {
      v[i] = hn::Add(hn::ConcatEven(d, v[2 * i + 1], v[2 * i]),
                     hn::ConcatOdd(d, v[2 * i + 1], v[2 * i]));
    }
  }
#endif
  return v[0];
}

std::size_t padded_channels(int channels) {
  return (static_cast<std::size_t>(channels) + kLanes - 1) / kLanes * kLanes;
}

// Row y of the hidden layer between two pixels of zeros, each pixel padded to whole vectors with
// zeros that are there already; all zero beyond the image.
HWY_INLINE void padded_row(const HeadUpdate& u, int y, const OwnRows& own, float* out,
                           std::size_t pitch) {
  const HeadStep& s = u.step;
  const auto width = static_cast<std::size_t>(s.width);
  const auto channels = static_cast<std::size_t>(s.channels);
  if (y < 0 || y >= s.height) {
    std::memset(out, 0, (width + 2) * pitch * sizeof(float));
    return;
  }
  const std::size_t at = static_cast<std::size_t>(y) * width * channels;
  const std::size_t bytes = channels * sizeof(float);
  float* first = out + pitch;
  if (u.hidden == nullptr) {
    hidden_row(s, y, first, pitch);
    const bool wanted = s.hidden != nullptr && own.has(y);
    for (std::size_t x = 0; x < width && wanted; ++x) {
      std::memcpy(s.hidden + at + x * channels, first + x * pitch, bytes);
    }
  } else {
    for (std::size_t x = 0; x < width; ++x) {
      std::memcpy(first + x * pitch, u.hidden + at + x * channels, bytes);
    }
  }
}

// conv3x3 at kLanes pixels; the first window's corners are rows[ky].
HWY_INLINE FullVec convolve_pixels(const HeadUpdate& u, const float* const (&rows)[3],
                                   std::size_t pitch) {
  const FullTag d;
  FullVec sum[kLanes];
  LCDM_UNROLL for (std::size_t i = 0; i < kLanes; ++i) sum[i] = hn::Zero(d);
  for (std::size_t c = 0; c < pitch; c += kLanes) {
    LCDM_UNROLL for (std::size_t ky = 0; ky < 3; ++ky) {
      LCDM_UNROLL for (std::size_t kx = 0; kx < 3; ++kx) {
        const FullVec w = hn::LoadU(d, u.weights + (3 * ky + kx) * pitch + c);
        LCDM_UNROLL for (std::size_t i = 0; i < kLanes; ++i) {
          sum[i] = hn::MulAdd(hn::LoadU(d, rows[ky] + (i + kx) * pitch + c), w, sum[i]);
        }
      }
    }
  }
  return sums_of_lanes(sum);
}

HWY_INLINE float convolve_pixel(const HeadUpdate& u, const float* const (&rows)[3],
                                std::size_t pitch) {
  const FullTag d;
  FullVec sum = hn::Zero(d);
  for (std::size_t t = 0; t < 9; ++t) {
    for (std::size_t c = 0; c < pitch; c += kLanes) {
      sum = hn::MulAdd(hn::LoadU(d, rows[t / 3] + t % 3 * pitch + c),
                       hn::LoadU(d, u.weights + t * pitch + c), sum);
    }
  }
  return hn::GetLane(hn::SumOfLanes(d, sum));
}

// p * state + q * (bias + out) of one row, from the three padded rows around it.
HWY_INLINE void update_row(const HeadUpdate& u, int y, const float* const (&rows)[3],
                           std::size_t pitch) {
  const FullTag d;
  const auto width = static_cast<std::size_t>(u.step.width);
  const float* state = u.state + static_cast<std::size_t>(y) * width;
  float* next = u.next + static_cast<std::size_t>(y) * width;
  std::size_t x = 0;
  for (; x + kLanes <= width; x += kLanes) {
    const float* const windows[3] = {rows[0] + x * pitch, rows[1] + x * pitch, rows[2] + x * pitch};
    const FullVec out = hn::Add(convolve_pixels(u, windows, pitch), hn::Set(d, u.bias));
    const FullVec kept = hn::Mul(hn::Set(d, u.p), hn::LoadU(d, state + x));
    hn::StoreU(hn::MulAdd(hn::Set(d, u.q), out, kept), d, next + x);
  }
  for (; x < width; ++x) {
    const float* const windows[3] = {rows[0] + x * pitch, rows[1] + x * pitch, rows[2] + x * pitch};
    next[x] = u.p * state[x] + u.q * (u.bias + convolve_pixel(u, windows, pitch));
  }
}

void float_rows(const HeadUpdate& u, int begin, int end, float* scratch) {
  const std::size_t pitch = padded_channels(u.step.channels);
  const std::size_t row_floats = static_cast<std::size_t>(u.step.width + 2) * pitch;
  std::memset(scratch, 0, 3 * row_floats * sizeof(float));  // the padding
  const auto slot = [&](int row) { return scratch + (row + 1) % 3 * row_floats; };
  int loaded = begin - 1;
  for (int y = begin; y < end; ++y) {
    for (; loaded <= y + 1; ++loaded) {
      padded_row(u, loaded, {begin, end}, slot(loaded), pitch);
    }
    update_row(u, y, {slot(y - 1), slot(y), slot(y + 1)}, pitch);
  }
}

// The same in pairs of halves, where one pixel's channels are one vector: twice the floats'
// multiply-adds in an instruction, and half the bytes of the hidden layer.
class NarrowRows {
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

  HWY_INLINE NarrowRows(const HeadUpdate& u, const OwnRows& own, float* scratch)
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

  // kPixels neighbours of one place.
  template <std::size_t kPixels>
  HWY_INLINE void hidden_pixels(int y, std::size_t x, std::size_t place, float* out) {
    const FullTag d;
    const std::size_t at = (static_cast<std::size_t>(y) * width_ + x) * kLanes;
    const FullVec scale = hn::LoadU(d, s_.scale);
    const FullVec constant = hn::LoadU(d, s_.constant + place * kLanes);
    FullVec h[kPixels];
    LCDM_UNROLL for (std::size_t i = 0; i < kPixels; ++i) {
      const float* from = s_.shared + at + i * kLanes;
      hwy::Prefetch(from + kAhead);
      h[i] = hn::MulAdd(scale, hn::LoadU(d, from), constant);
    }
    const int first_row = std::max(y - 2, 0);
    const int last_row = std::min(y + 2, s_.height - 1);
    for (int row = first_row; row <= last_row && s_.state != nullptr; ++row) {
      const std::size_t taps = place * 15 + 3 * static_cast<std::size_t>(row - y + 2);
      add_state(state_slot(row) + x, s_.composed + taps * kLanes, h);
    }
    LCDM_UNROLL for (std::size_t i = 0; i < kPixels; ++i) {
      if (s_.relu) h[i] = hn::Max(h[i], hn::Zero(d));
      if (s_.hidden != nullptr && own_.has(y)) hn::StoreU(h[i], d, s_.hidden + at + i * kLanes);
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
    hidden_pixels<1>(y, 0, row, out);
    std::size_t x = 1;
    for (; x + 8 < width_; x += 8) hidden_pixels<8>(y, x, row + 1, out);
    for (; x + 2 < width_; x += 2) hidden_pixels<2>(y, x, row + 1, out);
    for (; x < width_; ++x) {
      hidden_pixels<1>(y, x, row + place_along(static_cast<int>(x), s_.width), out);
    }
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

void update_rows(const HeadUpdate& u, int begin, int end, float* scratch) {
  if (u.precision == Precision::kFloat32) {
    float_rows(u, begin, end, scratch);
  } else {
    NarrowRows(u, {begin, end}, scratch).compute();
  }
}

std::size_t update_scratch(const HeadUpdate& u) {
  if (u.precision != Precision::kFloat32) return NarrowRows::scratch_floats(u);
  return 3 * static_cast<std::size_t>(u.step.width + 2) * padded_channels(u.step.channels);
}

// 1 / (0.01 + 9.99 / (1 + e^-logit)) = (1 + e) / (10 + 0.01 e) with e = e^-logit.
void depth(const ToDepth& t, int begin, int end) {
  for_channels(static_cast<std::size_t>(end - begin), [&](auto d, std::size_t i) HWY_ATTR {
    const std::size_t at = static_cast<std::size_t>(begin) + i;
    const auto logit =
        hn::MulAdd(hn::LoadU(d, t.state + at), hn::Set(d, t.deviation), hn::Set(d, t.mean));
    const auto e = exp_approx(d, hn::Sub(hn::Zero(d), logit));
    const auto disparity = hn::MulAdd(e, hn::Set(d, 0.01F), hn::Set(d, 10.0F));
    const auto metres = hn::Div(hn::Add(hn::Set(d, 1.0F), e), disparity);
    hn::StoreU(hn::Mul(metres, hn::Set(d, t.scale)), d, t.metres + at);
  });
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm::kernels {

HWY_EXPORT(hidden_rows);
HWY_EXPORT(padded_channels);
HWY_EXPORT(update_rows);
HWY_EXPORT(update_scratch);
HWY_EXPORT(depth);

namespace {

float word_of(float first, float second) {
  return std::bit_cast<float>(bfloat16_pair(first, second));
}

}  // namespace

void head_hidden_rows(const HeadStep& step, int begin, int end) {
  HWY_DYNAMIC_DISPATCH(hidden_rows)(step, begin, end);
}

Precision head_precision(Precision wanted, int channels) {
  const bool narrow = wanted >= Precision::kBfloat16 && channels == vector_lanes() &&
                      support_of(Precision::kBfloat16) == Support::kNative;
  return narrow ? Precision::kBfloat16 : Precision::kFloat32;
}

// Words of two neighbours of a row of five taps, the last one's alone.
std::vector<float> pack_composed(std::span<const float> taps, int channels, Precision precision) {
  if (precision == Precision::kFloat32) return {taps.begin(), taps.end()};
  const auto pitch = static_cast<std::size_t>(channels);
  std::vector<float> out;
  for (std::size_t row = 0; row < taps.size(); row += 5 * pitch) {
    for (std::size_t tap = 0; tap < 5; tap += 2) {
      for (std::size_t c = row + tap * pitch; c < row + (tap + 1) * pitch; ++c) {
        out.push_back(word_of(taps[c], tap < 4 ? taps[c + pitch] : 0.0F));
      }
    }
  }
  return out;
}

// Floats are padded to whole vectors; the words of each tap come twice, for both pixels of one.
std::vector<float> pack_update_weights(std::span<const float> taps, int channels,
                                       Precision precision) {
  const auto count = static_cast<std::size_t>(channels);
  LCDM_CHECK(precision == Precision::kFloat32 || count % 2 == 0);
  std::vector<float> out;
  for (std::size_t tap = 0; tap < taps.size(); tap += count) {
    const std::span<const float> of_tap = taps.subspan(tap, count);
    if (precision == Precision::kFloat32) {
      out.insert(out.end(), of_tap.begin(), of_tap.end());
      out.resize(out.size() + HWY_DYNAMIC_DISPATCH(padded_channels)(channels) - count);
    } else {
      for (std::size_t i = 0; i < 2 * count; i += 2) {
        out.push_back(word_of(of_tap[i % count], of_tap[i % count + 1]));
      }
    }
  }
  return out;
}

std::size_t head_update_scratch(const HeadUpdate& u) {
  return HWY_DYNAMIC_DISPATCH(update_scratch)(u);
}

void head_update_rows(const HeadUpdate& u, int begin, int end, float* scratch) {
  HWY_DYNAMIC_DISPATCH(update_rows)(u, begin, end, scratch);
}

void depth_range(const ToDepth& t, int begin, int end) {
  HWY_DYNAMIC_DISPATCH(depth)(t, begin, end);
}

}  // namespace lcdm::kernels
#endif  // HWY_ONCE
