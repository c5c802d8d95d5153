#include "firmware/nn/kernels/conv.h"

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "firmware/nn/kernels/conv.cpp"
#include "firmware/nn/kernels/simd.h"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
#include "firmware/nn/kernels/gemm-inl.h"
#include "firmware/nn/kernels/rows-inl.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

// In a padded row the three taps of a kernel row lie side by side: so one output pixel's input is
// three runs of 3 * channels floats, and the convolution is a product with those rows.
void conv_rows(const Conv3x3& conv, int begin, int end, float* scratch) {
  const std::size_t row_floats = static_cast<std::size_t>(conv.width + 2) * conv.channels;
  const auto slot = [&](int row) { return scratch + (row + 1) % 3 * row_floats; };
  const int out_width = conv.width / conv.stride;
  const std::ptrdiff_t columns = conv.weights.columns;
  const std::ptrdiff_t out_pitch = out_width * columns;
  int loaded = begin * conv.stride - 1;  // the next row to load
  for (int y = begin; y < end; ++y) {
    const int top = y * conv.stride - 1;
    for (; loaded <= top + 2; ++loaded) load_row(conv, loaded, slot(loaded));
    const RowInput rows = {{slot(top), slot(top + 1), slot(top + 2)},
                           3,
                           3 * conv.channels,
                           static_cast<std::ptrdiff_t>(conv.stride) * conv.channels,
                           out_width};
    multiply(rows, conv.weights, {conv.output + y * out_pitch, nullptr, columns, conv.activation});
  }
}

// One output pixel whose window may leave the image.
HWY_INLINE void depthwise_pixel(const Depthwise3x3& conv, int y, int x, float* out) {
  const auto channels = static_cast<std::size_t>(conv.channels);
  for_channels(channels, [&](auto d, std::size_t c) HWY_ATTR {
    auto sum = hn::LoadU(d, conv.bias + c);
    for (int t = 0; t < 9; ++t) {
      const int sy = y * conv.stride + t / 3 - 1;
      const int sx = x * conv.stride + t % 3 - 1;
      if (sy < 0 || sy >= conv.height || sx < 0 || sx >= conv.width) continue;
      const float* in = conv.input + (static_cast<std::size_t>(sy) * conv.width + sx) * channels;
      sum = hn::MulAdd(hn::LoadU(d, in + c), hn::LoadU(d, conv.weights + t * channels + c), sum);
    }
    hn::StoreU(activate(d, Activation::kSilu, sum), d, out + c);
  });
}

// kPixels neighbouring output pixels, all windows inside the image; `in` is the first window's
// corner. Columns that windows share are loaded once.
template <std::size_t kStride, std::size_t kPixels>
HWY_INLINE void depthwise_pixels(const Depthwise3x3& conv, const float* in, float* out) {
  constexpr std::size_t kColumns = (kPixels - 1) * kStride + 3;
  const auto channels = static_cast<std::size_t>(conv.channels);
  const std::size_t pitch = static_cast<std::size_t>(conv.width) * channels;
  for_channels(channels, [&](auto d, std::size_t c) HWY_ATTR {
    using V = decltype(hn::Zero(d));
    V sum[kPixels];
    LCDM_UNROLL for (std::size_t p = 0; p < kPixels; ++p) sum[p] = hn::LoadU(d, conv.bias + c);
    LCDM_UNROLL for (std::size_t ky = 0; ky < 3; ++ky) {
      V column[kColumns];
      LCDM_UNROLL for (std::size_t i = 0; i < kColumns; ++i) {
        column[i] = hn::LoadU(d, in + ky * pitch + i * channels + c);
      }
      LCDM_UNROLL for (std::size_t kx = 0; kx < 3; ++kx) {
        const V w = hn::LoadU(d, conv.weights + (ky * 3 + kx) * channels + c);
        LCDM_UNROLL for (std::size_t p = 0; p < kPixels; ++p) {
          sum[p] = hn::MulAdd(column[p * kStride + kx], w, sum[p]);
        }
      }
    }
    LCDM_UNROLL for (std::size_t p = 0; p < kPixels; ++p) {
      hn::StoreU(activate(d, Activation::kSilu, sum[p]), d, out + p * channels + c);
    }
  });
}

template <int kStride>
HWY_INLINE void depthwise_row(const Depthwise3x3& conv, int y) {
  constexpr int kPixels = 4;
  const auto channels = static_cast<std::size_t>(conv.channels);
  const int out_width = conv.width / kStride;
  float* out = conv.output + static_cast<std::size_t>(y) * out_width * channels;
  const int top = y * kStride - 1;
  const bool inside = top >= 0 && top + 2 < conv.height;
  int x = 0;
  if (inside) {
    depthwise_pixel(conv, y, x++, out);
    for (; (x + kPixels - 1) * kStride + 1 < conv.width; x += kPixels) {
      const float* in =
          conv.input + (static_cast<std::size_t>(top) * conv.width + (x * kStride - 1)) * channels;
      depthwise_pixels<kStride, kPixels>(conv, in, out + x * channels);
    }
  }
  for (; x < out_width; ++x) depthwise_pixel(conv, y, x, out + x * channels);
}

void depthwise_rows(const Depthwise3x3& conv, int begin, int end) {
  for (int y = begin; y < end; ++y) {
    if (conv.stride == 1) {
      depthwise_row<1>(conv, y);
    } else {
      depthwise_row<2>(conv, y);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm::kernels {

HWY_EXPORT(conv_rows);
HWY_EXPORT(depthwise_rows);

std::size_t conv3x3_scratch(const Conv3x3& conv) {
  return 3 * static_cast<std::size_t>(conv.width + 2) * static_cast<std::size_t>(conv.channels);
}

void conv3x3_rows(const Conv3x3& conv, int begin, int end, float* scratch) {
  HWY_DYNAMIC_DISPATCH(conv_rows)(conv, begin, end, scratch);
}

void depthwise3x3_rows(const Depthwise3x3& conv, int begin, int end) {
  HWY_DYNAMIC_DISPATCH(depthwise_rows)(conv, begin, end);
}

}  // namespace lcdm::kernels
#endif  // HWY_ONCE
