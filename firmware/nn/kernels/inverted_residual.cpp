#include "firmware/nn/kernels/inverted_residual.h"

#include <algorithm>
#include <cstring>

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "firmware/nn/kernels/inverted_residual.cpp"
#include "firmware/base/simd.h"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
#include "firmware/nn/kernels/math-inl.h"
#include "firmware/nn/kernels/own_rows.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

// One strip: output columns [first, first + columns), with its ring of three expanded rows, each
// with the padding it needs, and one row of filtered pixels.
class Strip {
 public:
  HWY_INLINE Strip(const InvertedResidual& block, int first, int columns, float* scratch)
      : b_(block),
        first_(first),
        columns_(columns),
        left_(first * block.stride - 1),
        window_(block.window_columns(columns)),
        ring_(scratch),
        filtered_(scratch + 3 * row_floats()) {}

  HWY_INLINE void compute_rows(int begin, int end) {
    own_ = OwnRows{begin, end}.of_input(b_.stride);
    int loaded = own_.begin - 1;  // the next row to expand
    for (int y = begin; y < end; ++y) {
      const int top = y * b_.stride - 1;
      for (; loaded <= top + 2; ++loaded) expand_row(loaded);
      if (b_.project.precision == Precision::kFloat32) {
        filter_row<false>(top);
      } else {
        filter_row<true>(top);
      }
      project_row(y);
    }
  }

 private:
  std::size_t hidden() const { return static_cast<std::size_t>(b_.hidden); }
  std::size_t row_floats() const { return static_cast<std::size_t>(window_) * hidden(); }
  float* slot(int row) const {
    return ring_ + static_cast<std::size_t>((row + 1) % 3) * row_floats();
  }

  HWY_INLINE void expand_row(int row) {
    float* out = slot(row);
    if (row < 0 || row >= b_.height) {
      std::memset(out, 0, row_floats() * sizeof(float));
      return;
    }
    const int begin = std::max(left_, 0);
    const int end = std::min(left_ + window_, b_.width);
    std::memset(out, 0, static_cast<std::size_t>(begin - left_) * hidden() * sizeof(float));
    float* first = out + static_cast<std::size_t>(begin - left_) * hidden();
    const std::size_t pixel = static_cast<std::size_t>(row) * b_.width + begin;
    const RowInput pixels = {
        {b_.input + pixel * b_.channels}, 1, b_.channels, b_.channels, end - begin};
    multiply_rows(pixels, b_.expand, {first, nullptr, b_.hidden, Activation::kSilu});
    float* last = first + static_cast<std::size_t>(end - begin) * hidden();
    std::memset(last, 0,
                static_cast<std::size_t>(left_ + window_ - end) * hidden() * sizeof(float));
    if (b_.expanded != nullptr && own_.has(row))
      std::copy(first, last, b_.expanded + pixel * hidden());
  }

  // kPixels neighbouring pixels, the first at `column` of the strip. Columns that windows share are
  // loaded once.
  template <bool kRough, std::size_t kStride, std::size_t kPixels>
  HWY_INLINE void filter_pixels(const float* const (&rows)[3], std::size_t column) {
    constexpr std::size_t kColumns = (kPixels - 1) * kStride + 3;
    const std::size_t pitch = hidden();
    const std::size_t at = column * kStride * pitch;
    float* out = filtered_ + column * pitch;
    for_channels(pitch, [&](auto d, std::size_t c) HWY_ATTR {
      using V = decltype(hn::Zero(d));
      V sum[kPixels];
      LCDM_UNROLL for (std::size_t p = 0; p < kPixels; ++p) sum[p] = hn::LoadU(d, b_.taps_bias + c);
      LCDM_UNROLL for (std::size_t ky = 0; ky < 3; ++ky) {
        V pixel[kColumns];
        LCDM_UNROLL for (std::size_t i = 0; i < kColumns; ++i) {
          pixel[i] = hn::LoadU(d, rows[ky] + at + i * pitch + c);
        }
        LCDM_UNROLL for (std::size_t kx = 0; kx < 3; ++kx) {
          const V w = hn::LoadU(d, b_.taps + (ky * 3 + kx) * pitch + c);
          LCDM_UNROLL for (std::size_t p = 0; p < kPixels; ++p) {
            sum[p] = hn::MulAdd(pixel[p * kStride + kx], w, sum[p]);
          }
        }
      }
      LCDM_UNROLL for (std::size_t p = 0; p < kPixels; ++p) {
        hn::StoreU(activate<Activation::kSilu, kRough>(d, sum[p]), d, out + p * pitch + c);
      }
    });
  }

  template <bool kRough, std::size_t kStride>
  HWY_INLINE void filter_row(int top) {
    constexpr std::size_t kPixels = 4;
    const float* const rows[3] = {slot(top), slot(top + 1), slot(top + 2)};
    const auto columns = static_cast<std::size_t>(columns_);
    std::size_t x = 0;
    for (; x + kPixels <= columns; x += kPixels) filter_pixels<kRough, kStride, kPixels>(rows, x);
    for (; x < columns; ++x) filter_pixels<kRough, kStride, 1>(rows, x);
  }

  template <bool kRough>
  HWY_INLINE void filter_row(int top) {
    if (b_.stride == 1) {
      filter_row<kRough, 1>(top);
    } else {
      filter_row<kRough, 2>(top);
    }
  }

  HWY_INLINE void project_row(int y) {
    const std::size_t pixel = static_cast<std::size_t>(y) * (b_.width / b_.stride) + first_;
    if (b_.filtered != nullptr) {
      std::copy_n(filtered_, static_cast<std::size_t>(columns_) * hidden(),
                  b_.filtered + pixel * hidden());
    }
    const std::size_t at = pixel * b_.project.columns;
    const float* residual = b_.residual != nullptr ? b_.residual + at : nullptr;
    multiply_rows({{filtered_}, 1, b_.hidden, b_.hidden, columns_}, b_.project,
                  {b_.output + at, residual, b_.project.columns, Activation::kNone});
  }

  const InvertedResidual& b_;
  int first_;
  int columns_;
  int left_;     // column of the input under the ring's first pixel
  int window_;   // pixels of a ring row
  OwnRows own_;  // of the input
  float* ring_;
  float* filtered_;
};

void rows(const InvertedResidual& b, int begin, int end, float* scratch) {
  const int out_width = b.width / b.stride;
  const int step = b.strip_columns();
  for (int first = 0; first < out_width; first += step) {
    Strip(b, first, std::min(step, out_width - first), scratch).compute_rows(begin, end);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm::kernels {

HWY_EXPORT(rows);

int InvertedResidual::strip_columns() const {
  // A strip's three rows must stay in the second cache beside the weights, also where that has
  // 256 KB.
  constexpr int kRingFloats = (160 << 10) / static_cast<int>(sizeof(float));
  return std::clamp((kRingFloats / 3 / hidden - 2) / stride, 8, std::max(8, width / stride));
}

int InvertedResidual::window_columns(int columns) const { return (columns - 1) * stride + 3; }

std::size_t inverted_residual_scratch(const InvertedResidual& b) {
  const int columns = b.strip_columns();
  return static_cast<std::size_t>(3 * b.window_columns(columns) + columns) *
         static_cast<std::size_t>(b.hidden);
}

void inverted_residual_rows(const InvertedResidual& b, int begin, int end, float* scratch) {
  HWY_DYNAMIC_DISPATCH(rows)(b, begin, end, scratch);
}

}  // namespace lcdm::kernels
#endif  // HWY_ONCE
