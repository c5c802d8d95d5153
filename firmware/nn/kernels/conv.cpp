#include "firmware/nn/kernels/conv.h"

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "firmware/nn/kernels/conv.cpp"
#include "firmware/nn/kernels/simd.h"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
#include "firmware/nn/kernels/gemm-inl.h"
#include "firmware/nn/kernels/rows-inl.h"
#include "firmware/nn/kernels/upsampled-inl.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

// bias and activation of a row that has all its sums already.
HWY_INLINE void finish_row(const Conv3x3& conv, const float* sums, float* out) {
  const auto columns = static_cast<std::size_t>(conv.weights.columns);
  const std::size_t count = static_cast<std::size_t>(conv.width) * columns;
  with_activation(conv.activation, [&](auto kind) HWY_ATTR {
    for (std::size_t at = 0; at < count; at += columns) {
      for_channels(columns, [&](auto d, std::size_t c) HWY_ATTR {
        const auto sum = hn::Add(hn::LoadU(d, sums + at + c), hn::LoadU(d, conv.weights.bias + c));
        hn::StoreU(activate<decltype(kind)::value>(d, sum), d, out + at + c);
      });
    }
  });
}

// In a padded row the three taps of a kernel row lie side by side: so one output pixel's input is
// three runs of 3 * channels floats, and the convolution is a product with those rows.
void conv_rows(const Conv3x3& conv, int begin, int end, float* scratch) {
  const std::size_t row_floats = static_cast<std::size_t>(conv.width + 2) * conv.channels;
  const auto slot = [&](int row) { return scratch + (row + 1) % 3 * row_floats; };
  const int out_width = conv.width / conv.stride;
  const std::ptrdiff_t columns = conv.weights.columns;
  const std::ptrdiff_t out_pitch = out_width * columns;
  const bool has_share = conv.upsampled.data != nullptr;
  float* share = has_share ? scratch + 3 * row_floats : nullptr;
  UpsampledRows upsampled(conv.upsampled, begin, has_share ? share + out_pitch : nullptr);
  int loaded = begin * conv.stride - 1;  // the next row to load
  for (int y = begin; y < end; ++y) {
    float* out = conv.output + y * out_pitch;
    if (has_share) upsampled.row(y, share);
    if (conv.input_count == 0) {
      finish_row(conv, share, out);
      continue;
    }
    const int top = y * conv.stride - 1;
    for (; loaded <= top + 2; ++loaded) load_row(conv, loaded, slot(loaded));
    const RowInput rows = {{slot(top), slot(top + 1), slot(top + 2)},
                           3,
                           3 * conv.channels,
                           static_cast<std::ptrdiff_t>(conv.stride) * conv.channels,
                           out_width};
    multiply(rows, conv.weights, {out, share, columns, conv.activation});
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm::kernels {

HWY_EXPORT(conv_rows);

std::size_t conv3x3_scratch(const Conv3x3& conv) {
  const std::size_t ring =
      3 * static_cast<std::size_t>(conv.width + 2) * static_cast<std::size_t>(conv.channels);
  const UpsampledShare& up = conv.upsampled;
  if (up.data == nullptr) return ring;
  // Three rows of products, a row of vertical sums, a row of the share itself.
  const std::size_t products =
      static_cast<std::size_t>(up.width) * static_cast<std::size_t>(up.taps.columns);
  return ring + 3 * products + products / 3 +
         static_cast<std::size_t>(conv.width) * static_cast<std::size_t>(conv.weights.columns);
}

void conv3x3_rows(const Conv3x3& conv, int begin, int end, float* scratch) {
  HWY_DYNAMIC_DISPATCH(conv_rows)(conv, begin, end, scratch);
}

}  // namespace lcdm::kernels
#endif  // HWY_ONCE
