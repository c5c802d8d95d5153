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

// Output pixel 2i lies a quarter of a pixel before input pixel i, 2i + 1 a quarter behind it.
HWY_INLINE void bilinear_row(const ConvInput& in, int row, float* out, std::size_t pitch) {
  const auto channels = static_cast<std::size_t>(in.channels);
  const auto width = static_cast<std::size_t>(in.width);
  const int near_row = row / 2;
  const int far_row = std::clamp(row % 2 == 0 ? near_row - 1 : near_row + 1, 0, in.height - 1);
  const float* near_data = in.data + static_cast<std::size_t>(near_row) * width * channels;
  const float* far_data = in.data + static_cast<std::size_t>(far_row) * width * channels;
  for_channels(channels, [&](auto d, std::size_t c) HWY_ATTR {
    const auto quarter = hn::Set(d, 0.25F);
    const auto rest = hn::Set(d, 0.75F);
    const auto column = [&](std::size_t x) HWY_ATTR {
      return hn::MulAdd(rest, hn::LoadU(d, near_data + x * channels + c),
                        hn::Mul(quarter, hn::LoadU(d, far_data + x * channels + c)));
    };
    auto before = column(0);
    auto here = before;
    for (std::size_t x = 0; x < width; ++x) {
      const auto after = column(std::min(x + 1, width - 1));
      const auto most = hn::Mul(rest, here);
      hn::StoreU(hn::MulAdd(quarter, before, most), d, out + 2 * x * pitch + c);
      hn::StoreU(hn::MulAdd(quarter, after, most), d, out + (2 * x + 1) * pitch + c);
      before = here;
      here = after;
    }
  });
}

// condition + bias + conv3x3(state) with zero padding.
HWY_INLINE void embed_row(const Conv3x3& conv, int row, float* out) {
  const Embedding& e = conv.embedding;
  const auto channels = static_cast<std::size_t>(conv.channels);
  const float* condition =
      conv.inputs[0].data + static_cast<std::size_t>(row) * conv.width * channels;
  for (int x = 0; x < conv.width; ++x) {
    float state[9];
    for (int t = 0; t < 9; ++t) {
      const int sy = row + t / 3 - 1;
      const int sx = x + t % 3 - 1;
      const bool inside = sy >= 0 && sy < conv.height && sx >= 0 && sx < conv.width;
      state[t] = inside ? e.state[static_cast<std::size_t>(sy) * conv.width + sx] : 0.0F;
    }
    for_channels(channels, [&](auto d, std::size_t c) HWY_ATTR {
      auto sum = hn::Add(hn::LoadU(d, condition + x * channels + c), hn::LoadU(d, e.bias + c));
      LCDM_UNROLL for (std::size_t t = 0; t < 9; ++t) {
        sum = hn::MulAdd(hn::Set(d, state[t]), hn::LoadU(d, e.weights + t * channels + c), sum);
      }
      hn::StoreU(sum, d, out + x * channels + c);
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
  if (conv.embedding.state != nullptr) {
    embed_row(conv, row, first);
  } else {
    float* channel = first;
    for (int i = 0; i < conv.input_count; ++i) {
      const ConvInput& in = conv.inputs[static_cast<std::size_t>(i)];
      if (in.upsampling == Upsampling::kNone) copy_row(in, row, channel, pitch);
      if (in.upsampling == Upsampling::kNearest) nearest_row(in, row, channel, pitch);
      if (in.upsampling == Upsampling::kBilinear) bilinear_row(in, row, channel, pitch);
      channel += in.channels;
    }
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
