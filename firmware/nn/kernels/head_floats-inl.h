// The head's hidden layer and update in floats, any number of channels.
#if defined(LCDM_KERNELS_HEAD_FLOATS_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef LCDM_KERNELS_HEAD_FLOATS_INL_H
#undef LCDM_KERNELS_HEAD_FLOATS_INL_H
#else
#define LCDM_KERNELS_HEAD_FLOATS_INL_H
#endif

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <type_traits>

#include "firmware/nn/kernels/head.h"
#include "firmware/nn/kernels/math-inl.h"
#include "firmware/nn/kernels/own_rows.h"

#include "hwy/cache_control.h"

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

// Words from those of `shared` that are used to those that are fetched, floats or pairs: 6 KB.
// Larger pictures' come from memory, and are not asked for early enough otherwise.
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
      hn::StoreU(s.relu ? rectified(d, h[i]) : h[i], d, out + i * pitch + c);
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

inline std::size_t padded_channels(int channels) {
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

HWY_INLINE void float_rows(const HeadUpdate& u, int begin, int end, float* scratch) {
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

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#endif
