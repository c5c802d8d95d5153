// The rows of a 3x3 convolution, or of a chain of them, made one by one.
#if defined(LCDM_KERNELS_CONV_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef LCDM_KERNELS_CONV_INL_H
#undef LCDM_KERNELS_CONV_INL_H
#else
#define LCDM_KERNELS_CONV_INL_H
#endif

#include <algorithm>
#include <cstddef>
#include <cstring>

#include "firmware/nn/kernels/conv.h"
#include "firmware/nn/kernels/math-inl.h"
#include "firmware/nn/kernels/own_rows.h"
#include "firmware/nn/kernels/row_winograd-inl.h"
#include "firmware/nn/kernels/rows-inl.h"
#include "firmware/nn/kernels/upsampled-inl.h"

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

// bias and activation of a row that has all its sums already; rough beside narrow products. Few
// columns that fill a vector by themselves some times over are taken so many pixels at a time.
HWY_INLINE void finish_row(const Conv3x3& conv, const float* sums, float* out) {
  const auto columns = static_cast<std::size_t>(conv.weights.columns);
  const std::size_t count = static_cast<std::size_t>(conv.width) * columns;
  const std::size_t step = kLanes % columns == 0 ? kLanes : columns;
  HWY_ALIGN float repeated[kLanes];
  for (std::size_t i = 0; i < kLanes; ++i) repeated[i] = conv.weights.bias[i % columns];
  const float* bias = step == kLanes ? repeated : conv.weights.bias;
  with_activation(conv.activation, [&](auto kind) HWY_ATTR {
    constexpr Activation kKind = decltype(kind)::value;
    const bool rough = conv.upsampled.taps.precision != Precision::kFloat32;
    for (std::size_t at = 0; at < count; at += step) {
      for_channels(std::min(step, count - at), [&](auto d, std::size_t c) HWY_ATTR {
        const auto sum = hn::Add(hn::LoadU(d, sums + at + c), hn::LoadU(d, bias + c));
        hn::StoreU(rough ? activate<kKind, true>(d, sum) : activate<kKind>(d, sum), d,
                   out + at + c);
      });
    }
  });
}

// The rows of one convolution, in order; its input comes from memory or from the rows of the one
// before.
class ConvRows {
 public:
  // `first` is the first row that will be asked for; `before` null: the input is in memory. Only
  // `own` rows go to the convolution's output.
  HWY_INLINE void begin(const Conv3x3& conv, ConvRows* before, int first, const OwnRows& own,
                        float* scratch) {
    conv_ = &conv;
    before_ = before;
    own_ = own;
    row_words_ = conv.row_words();
    ring_ = scratch;
    loaded_ = first * conv.stride - 1;
    whole_ = ring_ + 3 * row_words_;
    if (conv.upsampled.data == nullptr) return;
    shares_ = whole_ + conv.whole_floats();
    upsampled_.begin(conv.upsampled, first, shares_ + 2 * conv_->output_row());
  }

  // Row y, [width / stride, columns].
  //
  // In a padded row the three taps of a kernel row lie side by side: so one output pixel's input is
  // three runs of 3 * channels floats, and the convolution is a product with those rows.
  HWY_NOINLINE void row(int y, float* out) {
    const float* share = shares_ != nullptr ? share_of(y) : nullptr;
    if (conv_->input_count == 0) {
      finish_row(*conv_, share, out);
    } else {
      const int top = y * conv_->stride - 1;
      for (; loaded_ <= top + 2; ++loaded_) load(loaded_);
      multiply(top, {out, share, conv_->weights.columns, conv_->activation, conv_->paired});
    }
    if (conv_->output == nullptr || !own_.has(y)) return;
    float* kept = conv_->output + static_cast<std::size_t>(y) * conv_->output_row();
    if (kept != out) std::memcpy(kept, out, conv_->output_row() * sizeof(float));
  }

 private:
  static std::size_t index(int row) { return static_cast<std::size_t>((row + 1) % 3); }
  float* slot(int row) const { return ring_ + index(row) * row_words_; }
  const RowRange& range(int row) const { return ranges_[index(row)]; }

  HWY_INLINE const float* share_of(int y) {
    float* odd = shares_ + conv_->output_row();
    if (y / 2 != pair_) upsampled_.pair(y / 2, shares_, odd);
    pair_ = y / 2;
    return y % 2 == 0 ? shares_ : odd;
  }

  HWY_INLINE void multiply(int top, const RowOutput& out) const {
    const int pixel = conv_->channels / numbers_per_word(conv_->weights.precision);
    RowInput rows = {{slot(top), slot(top + 1), slot(top + 2)},
                     3,
                     3 * pixel,
                     static_cast<std::ptrdiff_t>(conv_->stride) * pixel,
                     conv_->width / conv_->stride};
    if (conv_->row_winograd) {
      rows.run_length = kRowProducts * pixel;
      rows.stride = std::ptrdiff_t{2} * pixel;
      rows.transformed = true;
    }
    if (conv_->weights.precision == Precision::kFloat32) {
      multiply_rows(rows, conv_->weights, out);
    } else {
      multiply_narrow_rows({rows, {range(top), range(top + 1), range(top + 2)}}, conv_->weights,
                           out);
    }
  }

  HWY_INLINE void load(int row) {
    if (conv_->row_winograd) return load_transformed(row);
    if (conv_->weights.precision == Precision::kFloat32) return load_floats(row, slot(row));
    load_floats(row, whole_);
    ranges_[index(row)] = narrow_row(whole_, static_cast<int>(conv_->whole_floats()),
                                     conv_->weights.precision, slot(row));
  }

  HWY_INLINE void load_transformed(int row) {
    load_floats(row, whole_);
    const int channels = conv_->channels;
    std::fill_n(whole_ + static_cast<std::ptrdiff_t>(conv_->width + 2) * channels, channels,
                0.0F);  // what an odd row's last pair sees beyond it
    const int pairs = (conv_->width + 1) / 2;
    if (conv_->weights.precision == Precision::kFloat32) {
      transform_to_floats(whole_, pairs, channels, slot(row));
    } else {
      transform_to_halves(whole_, pairs, channels, slot(row));
    }
  }

  HWY_INLINE void load_floats(int row, float* out) {
    if (before_ == nullptr || row < 0 || row >= conv_->height) {
      load_row(*conv_, row, out);
      return;
    }
    const auto pixel = static_cast<std::size_t>(conv_->channels);
    float* first = out + pixel;
    float* end = first + static_cast<std::size_t>(conv_->width) * pixel;
    before_->row(row, first);
    std::memset(out, 0, pixel * sizeof(float));
    std::memset(end, 0, pixel * sizeof(float));
  }

  const Conv3x3* conv_ = nullptr;
  ConvRows* before_ = nullptr;
  OwnRows own_;
  std::size_t row_words_ = 0;
  float* ring_ = nullptr;    // three padded input rows, words of the weights' precision
  RowRange ranges_[3];       // of these, where they are narrow
  float* whole_ = nullptr;   // one such row of floats, before it is made narrow
  int loaded_ = 0;           // the next one to load
  float* shares_ = nullptr;  // two rows of the upsampled share; null: there is none
  int pair_ = -1;            // which two of its rows are there
  UpsampledRows upsampled_;
};

// The rows of a chain's last convolution, in order.
class ChainRows {
 public:
  // `first` is the first row that will be asked for, `own` as above, both of the last convolution.
  // Scratch: conv3x3_scratch floats.
  HWY_INLINE void begin(const ConvChain& chain, int first, OwnRows own, float* scratch) {
    last_ = static_cast<std::size_t>(chain.count) - 1;
    for (std::size_t i = last_ + 1; i-- > 0;) {
      const Conv3x3& conv = chain.convs[i];
      rows_[i].begin(conv, i > 0 ? &rows_[i - 1] : nullptr, first, own, scratch);
      scratch += conv.scratch_floats();
      first = std::max(0, first * conv.stride - 1);
      own = own.of_input(conv.stride);
    }
  }

  HWY_INLINE void row(int y, float* out) { rows_[last_].row(y, out); }

 private:
  ConvRows rows_[ConvChain::kMost];
  std::size_t last_ = 0;
};

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#endif
