// One padded input row of a 3x3 convolution, made from its sources.
#if defined(LCDM_KERNELS_ROWS_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef LCDM_KERNELS_ROWS_INL_H
#undef LCDM_KERNELS_ROWS_INL_H
#else
#define LCDM_KERNELS_ROWS_INL_H
#endif

#include <algorithm>
#include <cstddef>
#include <cstring>

#include "firmware/nn/kernels/conv.h"
#include "firmware/nn/kernels/math-inl.h"

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

// The writers below fill pixels of `out`, `pitch` floats apart, with the source's channels.

HWY_INLINE void copy_row(const ConvInput& in, int row, float* out, std::size_t pitch) {
  const auto channels = static_cast<std::size_t>(in.channels);
  const auto width = static_cast<std::size_t>(in.width);
  const float* from = in.data + static_cast<std::size_t>(row) * width * channels;
  if (pitch == channels) {
    std::memcpy(out, from, width * channels * sizeof(float));
    return;
  }
  for (std::size_t x = 0; x < width; ++x) {
    for_channels(channels, [&](auto d, std::size_t c) HWY_ATTR {
      hn::StoreU(hn::LoadU(d, from + x * channels + c), d, out + x * pitch + c);
    });
  }
}

HWY_INLINE void nearest_row(const ConvInput& in, int row, float* out, std::size_t pitch) {
  const auto channels = static_cast<std::size_t>(in.channels);
  const auto width = static_cast<std::size_t>(in.width);
  const float* from = in.data + static_cast<std::size_t>(row / 2) * width * channels;
  for (std::size_t x = 0; x < width; ++x) {
    for_channels(channels, [&](auto d, std::size_t c) HWY_ATTR {
      const auto v = hn::LoadU(d, from + x * channels + c);
      hn::StoreU(v, d, out + 2 * x * pitch + c);
      hn::StoreU(v, d, out + (2 * x + 1) * pitch + c);
    });
  }
}

HWY_INLINE int reflected(int i, int size) {
  if (i < 0) return -i;
  return i < size ? i : 2 * size - 2 - i;
}

// Fills `out`, [width + 2, channels], with input row `row` and a pixel of padding at either end;
// row -1 and row `height` are padding themselves.
HWY_INLINE void load_row(const Conv3x3& conv, int row, float* out) {
  const auto pitch = static_cast<std::size_t>(conv.channels);
  const auto width = static_cast<std::size_t>(conv.width);
  const bool reflect = conv.padding == Padding::kReflect;
  if (row < 0 || row >= conv.height) {
    if (!reflect) {
      std::memset(out, 0, (width + 2) * pitch * sizeof(float));
      return;
    }
    row = reflected(row, conv.height);
  }
  float* first = out + pitch;
  float* channel = first;
  for (int i = 0; i < conv.input_count; ++i) {
    const ConvInput& in = conv.inputs[static_cast<std::size_t>(i)];
    if (in.upsampling == Upsampling::kNone) copy_row(in, row, channel, pitch);
    if (in.upsampling == Upsampling::kNearest) nearest_row(in, row, channel, pitch);
    channel += in.channels;
  }
  float* end = first + width * pitch;
  if (reflect) {
    std::memcpy(out, first + pitch, pitch * sizeof(float));
    std::memcpy(end, end - 2 * pitch, pitch * sizeof(float));
  } else {
    std::memset(out, 0, pitch * sizeof(float));
    std::memset(end, 0, pitch * sizeof(float));
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#endif
