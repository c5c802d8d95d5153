#include "firmware/nn/kernels/conv.h"

#include "firmware/nn/kernels/row_winograd.h"

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "firmware/nn/kernels/conv.cpp"
#include "firmware/base/simd.h"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
#include "firmware/nn/kernels/conv-inl.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

void conv_rows(const ConvChain& chain, int begin, int end, float* scratch) {
  ChainRows rows;
  rows.begin(chain, begin, {begin, end}, scratch);
  const Conv3x3& last = chain.convs[static_cast<std::size_t>(chain.count) - 1];
  for (int y = begin; y < end; ++y) {
    rows.row(y, last.output + static_cast<std::size_t>(y) * last.output_row());
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm::kernels {

HWY_EXPORT(conv_rows);

std::size_t UpsampledShare::scratch_floats() const {
  if (data == nullptr) return 0;
  return 3 * static_cast<std::size_t>(width) * static_cast<std::size_t>(taps.columns);
}

std::size_t Conv3x3::output_row() const {
  const int pixels = width / stride;
  return static_cast<std::size_t>(paired ? (pixels + 1) / 2 : pixels) *
         static_cast<std::size_t>(weights.columns);
}

std::size_t Conv3x3::row_words() const {
  const auto pixel = static_cast<std::size_t>(channels / numbers_per_word(weights.precision));
  return row_winograd ? row_winograd_words(width, pixel)
                      : static_cast<std::size_t>(width + 2) * pixel;
}

std::size_t Conv3x3::whole_floats() const {
  if (weights.precision == Precision::kFloat32 && !row_winograd) return 0;
  // The last pair of an odd row reads one pixel more.
  return static_cast<std::size_t>(width + (row_winograd ? 3 : 2)) *
         static_cast<std::size_t>(channels);
}

std::size_t Conv3x3::scratch_floats() const {
  const std::size_t ring = 3 * row_words() + whole_floats();
  if (upsampled.data == nullptr) return ring;
  const std::size_t share_rows =
      2 * static_cast<std::size_t>(width) * static_cast<std::size_t>(weights.columns);
  return ring + upsampled.scratch_floats() + share_rows;
}

std::size_t conv3x3_scratch(const ConvChain& chain) {
  std::size_t floats = 0;
  for (int i = 0; i < chain.count; ++i) {
    floats += chain.convs[static_cast<std::size_t>(i)].scratch_floats();
  }
  return floats;
}

void conv3x3_rows(const ConvChain& chain, int begin, int end, float* scratch) {
  HWY_DYNAMIC_DISPATCH(conv_rows)(chain, begin, end, scratch);
}

}  // namespace lcdm::kernels
#endif  // HWY_ONCE
