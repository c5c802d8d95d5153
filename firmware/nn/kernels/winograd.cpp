#include "firmware/nn/kernels/winograd.h"

#include <algorithm>
#include <array>

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "firmware/nn/kernels/winograd.cpp"
#include "firmware/base/simd.h"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
#include "firmware/nn/kernels/conv-inl.h"
#include "firmware/nn/kernels/own_rows.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

constexpr std::size_t kTile = kWinogradTile;
constexpr std::size_t kPatch = kTile + 2;  // input pixels of a tile, each way

// B^T d of one row or column of a patch.
template <class D, class V>
HWY_INLINE void transform_input(D d, const V (&x)[kPatch], V (&out)[kPatch]) {
  const V two = hn::Set(d, 2.0F);
  const V four = hn::Set(d, 4.0F);
  const V five = hn::Set(d, 5.0F);
  const V a = hn::NegMulAdd(four, x[2], x[4]);
  const V b = hn::NegMulAdd(four, x[1], x[3]);
  const V c = hn::Sub(x[4], x[2]);
  const V e = hn::Mul(two, hn::Sub(x[3], x[1]));
  out[0] = hn::MulAdd(four, x[0], hn::NegMulAdd(five, x[2], x[4]));
  out[1] = hn::Add(a, b);
  out[2] = hn::Sub(a, b);
  out[3] = hn::Add(c, e);
  out[4] = hn::Sub(c, e);
  out[5] = hn::MulAdd(four, x[1], hn::NegMulAdd(five, x[3], x[5]));
}

// A^T m of one row or column of products.
template <class D, class V>
HWY_INLINE void transform_output(D d, const V (&m)[kPatch], V (&out)[kTile]) {
  const V sum1 = hn::Add(m[1], m[2]);
  const V sum2 = hn::Add(m[3], m[4]);
  const V diff1 = hn::Sub(m[1], m[2]);
  const V diff2 = hn::Sub(m[3], m[4]);
  out[0] = hn::Add(m[0], hn::Add(sum1, sum2));
  out[1] = hn::MulAdd(hn::Set(d, 2.0F), diff2, diff1);
  out[2] = hn::MulAdd(hn::Set(d, 4.0F), sum2, sum1);
  out[3] = hn::Add(hn::MulAdd(hn::Set(d, 8.0F), diff2, diff1), m[5]);
}

// Floats from one product's rows to the next one's, for `tiles` rows of `columns`: an odd number of
// cache lines, so that what a tile has in all products lies in different sets of the first cache.
// Widths that are powers of two would have them all in one.
HWY_INLINE std::size_t product_pitch(std::size_t tiles, std::size_t columns) {
  constexpr std::size_t kLine = 64 / sizeof(float);
  return ((tiles * columns + kLine - 1) / kLine | 1) * kLine;
}

// Some strips of tiles at a time: their input rows, the patches and the products.
class Batch {
 public:
  HWY_INLINE Batch(const WinogradConv& winograd, const OwnRows& own, float* scratch)
      : w_(winograd),
        conv_(winograd.conv),
        channels_(static_cast<std::size_t>(conv_.channels)),
        columns_(static_cast<std::size_t>(conv_.weights.columns)),
        across_(tiles_across(conv_)),
        strips_(strips_of(conv_)),
        patch_pitch_(product_pitch(strips_ * across_, channels_)),
        product_pitch_(product_pitch(strips_ * across_, columns_)) {
    rows_ = scratch;
    patches_ = rows_ + (kTile * strips_ + 2) * row_floats();
    products_ = patches_ + kWinogradProducts * patch_pitch_;
    shares_ = products_ + kWinogradProducts * product_pitch_;
    float* rest = shares_;
    if (conv_.upsampled.data != nullptr) {
      rest += kTile * strips_ * out_floats();
      upsampled_.begin(conv_.upsampled, own.begin, rest);
      rest += conv_.upsampled.scratch_floats();
    }
    if (w_.before.count > 0) before_.begin(w_.before, std::max(0, own.begin - 1), own, rest);
  }

  // Output rows [y, end), at most strips() of them; y is a multiple of kTile.
  HWY_INLINE void compute(int y, int end) {
    const std::size_t strips = (static_cast<std::size_t>(end - y) + kTile - 1) / kTile;
    // The last two rows of the batch before are the first two of this one.
    const std::size_t kept = loaded_ == y + 1 ? 2 : 0;
    std::memmove(rows_, rows_ + kTile * strips_ * row_floats(),
                 kept * row_floats() * sizeof(float));
    const std::size_t count_rows = kTile * strips + 2;
    for (std::size_t i = kept; i < count_rows; ++i) load(y - 1 + static_cast<int>(i), i);
    loaded_ = y + static_cast<int>(kTile * strips) + 1;
    float* share = shares_;
    for (int row = y; row < end && conv_.upsampled.data != nullptr; row += 2) {
      upsampled_.pair(row / 2, share, share + out_floats());
      share += 2 * out_floats();
    }
    for (std::size_t s = 0; s < strips; ++s) {
      for (std::size_t t = 0; t < across_; ++t) take_apart(s, t);
    }
    const std::size_t count = strips * across_;
    const std::size_t step = packed_floats(conv_.channels, conv_.weights.columns);
    for (std::size_t f = 0; f < kWinogradProducts; ++f) {
      const float* panels = w_.panels + f * step;
      const PackedMatrix matrix = {panels, panels + step - padded_columns(), conv_.channels,
                                   conv_.weights.columns};
      const RowInput patches = {{patches_ + f * patch_pitch_},
                                1,
                                conv_.channels,
                                conv_.channels,
                                static_cast<int>(count)};
      multiply_rows(
          patches, matrix,
          {products_ + f * product_pitch_, nullptr, conv_.weights.columns, Activation::kNone});
    }
    with_activation(conv_.activation, [&](auto kind) HWY_ATTR {
      for (std::size_t s = 0; s < strips; ++s) {
        for (std::size_t t = 0; t < across_; ++t) put_together<decltype(kind)::value>(y, end, s, t);
      }
    });
  }

  int rows() const { return static_cast<int>(kTile * strips_); }

  static std::size_t tiles_across(const Conv3x3& conv) {
    return (static_cast<std::size_t>(conv.width) + kTile - 1) / kTile;
  }
  // So many that the products have rows enough.
  static std::size_t strips_of(const Conv3x3& conv) {
    constexpr std::size_t kRows = 24;
    return std::max<std::size_t>(1, kRows / tiles_across(conv));
  }

 private:
  std::size_t row_floats() const { return (kTile * across_ + 2) * channels_; }
  std::size_t out_floats() const { return static_cast<std::size_t>(conv_.width) * columns_; }
  std::size_t padded_columns() const { return (columns_ + kLanes - 1) / kLanes * kLanes; }

  // Row `row` of the image becomes row i of the batch; zeros to the right of the image.
  HWY_INLINE void load(int row, std::size_t i) {
    float* out = rows_ + i * row_floats();
    const std::size_t used = static_cast<std::size_t>(conv_.width + 2) * channels_;
    if (row > conv_.height) {
      std::memset(out, 0, row_floats() * sizeof(float));  // below what any output looks at
    } else if (w_.before.count == 0 || row < 0 || row == conv_.height) {
      load_row(conv_, row, out);
    } else {
      before_.row(row, out + channels_);
      std::memset(out, 0, channels_ * sizeof(float));
      std::memset(out + used - channels_, 0, channels_ * sizeof(float));
    }
    if (row_floats() > used) std::memset(out + used, 0, (row_floats() - used) * sizeof(float));
  }

  // The patch of tile t of strip s: [product][tile][channel].
  HWY_INLINE void take_apart(std::size_t s, std::size_t t) {
    const float* from = rows_ + kTile * s * row_floats() + kTile * t * channels_;
    float* to = patches_ + (s * across_ + t) * channels_;
    for_channels(channels_, [&](auto d, std::size_t c) HWY_ATTR {
      using V = decltype(hn::Zero(d));
      V half[kPatch][kPatch];  // rows transformed; [column][row]
      LCDM_UNROLL for (std::size_t y = 0; y < kPatch; ++y) {
        V x[kPatch];
        V out[kPatch];
        LCDM_UNROLL for (std::size_t i = 0; i < kPatch; ++i) {
          x[i] = hn::LoadU(d, from + y * row_floats() + i * channels_ + c);
        }
        transform_input(d, x, out);
        LCDM_UNROLL for (std::size_t i = 0; i < kPatch; ++i) half[i][y] = out[i];
      }
      LCDM_UNROLL for (std::size_t x = 0; x < kPatch; ++x) {
        V out[kPatch];
        transform_input(d, half[x], out);
        LCDM_UNROLL for (std::size_t y = 0; y < kPatch; ++y) {
          hn::StoreU(out[y], d, to + (kPatch * y + x) * patch_pitch_ + c);
        }
      }
    });
  }

  // Its output pixels, with bias, share and activation.
  template <Activation kActivation>
  HWY_INLINE void put_together(int y, int end, std::size_t s, std::size_t t) {
    const float* from = products_ + (s * across_ + t) * columns_;
    const auto first_row = static_cast<std::size_t>(y) + kTile * s;
    const std::size_t rows = std::min(kTile, static_cast<std::size_t>(end) - first_row);
    const std::size_t pixels = std::min(kTile, static_cast<std::size_t>(conv_.width) - kTile * t);
    for_channels(columns_, [&](auto d, std::size_t c) HWY_ATTR {
      using V = decltype(hn::Zero(d));
      V half[kTile][kPatch];  // [row][column]
      LCDM_UNROLL for (std::size_t x = 0; x < kPatch; ++x) {
        V m[kPatch];
        V out[kTile];
        LCDM_UNROLL for (std::size_t i = 0; i < kPatch; ++i) {
          m[i] = hn::LoadU(d, from + (kPatch * i + x) * product_pitch_ + c);
        }
        transform_output(d, m, out);
        LCDM_UNROLL for (std::size_t i = 0; i < kTile; ++i) half[i][x] = out[i];
      }
      const V bias = hn::LoadU(d, conv_.weights.bias + c);
      for (std::size_t i = 0; i < rows; ++i) {
        V out[kTile];
        transform_output(d, half[i], out);
        const std::size_t pixel = kTile * t;
        float* to = conv_.output + (first_row + i) * out_floats() + pixel * columns_ + c;
        const float* share = shares_ + (kTile * s + i) * out_floats() + pixel * columns_ + c;
        for (std::size_t x = 0; x < pixels; ++x) {
          V sum = hn::Add(out[x], bias);
          if (conv_.upsampled.data != nullptr) {
            sum = hn::Add(sum, hn::LoadU(d, share + x * columns_));
          }
          hn::StoreU(activate<kActivation>(d, sum), d, to + x * columns_);
        }
      }
    });
  }

  const WinogradConv& w_;
  const Conv3x3& conv_;
  std::size_t channels_;
  std::size_t columns_;
  std::size_t across_;  // tiles of a strip
  std::size_t strips_;  // of a batch
  std::size_t patch_pitch_;
  std::size_t product_pitch_;
  float* rows_;      // padded input rows
  float* patches_;   // [product, tile, channels], patch_pitch_ from product to product
  float* products_;  // [product, tile, columns], product_pitch_ alike
  float* shares_;    // rows of the upsampled share
  UpsampledRows upsampled_;
  ChainRows before_;
  int loaded_ = -1;  // the row after the last one in rows_
};

void rows(const WinogradConv& winograd, int begin, int end, float* scratch) {
  Batch batch(winograd, {begin, end}, scratch);
  for (int y = begin; y < end; y += batch.rows()) {
    batch.compute(y, std::min(end, y + batch.rows()));
  }
}

std::size_t scratch_floats(const WinogradConv& winograd) {
  const Conv3x3& conv = winograd.conv;
  const std::size_t across = Batch::tiles_across(conv);
  const std::size_t strips = Batch::strips_of(conv);
  const auto channels = static_cast<std::size_t>(conv.channels);
  const auto columns = static_cast<std::size_t>(conv.weights.columns);
  const bool has_share = conv.upsampled.data != nullptr;
  const std::size_t shares =
      has_share ? kTile * strips * static_cast<std::size_t>(conv.width) * columns : 0;
  return (kTile * strips + 2) * (kTile * across + 2) * channels +
         kWinogradProducts *
             (product_pitch(strips * across, channels) + product_pitch(strips * across, columns)) +
         shares;
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm::kernels {

HWY_EXPORT(rows);
HWY_EXPORT(scratch_floats);

// Measured at XS, 640x192; below, the transforms and the fourfold weights cost what they save.
// Bytes are always faster at once, halves where channels are few.
bool winograd_pays(const Conv3x3& conv, int columns, Precision direct) {
  if (direct == Precision::kInt8) return false;
  const int fewest = direct == Precision::kFloat32 ? 16 : 32;
  return conv.stride == 1 && conv.channels >= fewest && columns >= 16 &&
         conv.height * conv.width >= 400;
}

std::size_t winograd_floats(int channels, int columns) {
  return kWinogradProducts * packed_floats(channels, columns);
}

void pack_winograd(int channels, int columns, const std::function<float(int, int, int)>& weight,
                   std::span<float> out) {
  constexpr double kG[6][3] = {{1.0 / 4, 0, 0},
                               {-1.0 / 6, -1.0 / 6, -1.0 / 6},
                               {-1.0 / 6, 1.0 / 6, -1.0 / 6},
                               {1.0 / 24, 1.0 / 12, 1.0 / 6},
                               {1.0 / 24, -1.0 / 12, 1.0 / 6},
                               {0, 0, 1}};
  const std::size_t step = packed_floats(channels, columns);
  for (std::size_t f = 0; f < kWinogradProducts; ++f) {
    const double* row = kG[f / 6];
    const double* column = kG[f % 6];
    const auto transformed = [&](int c, int n) {
      double sum = 0;
      for (int tap = 0; tap < 9; ++tap) {
        sum += row[tap / 3] * column[tap % 3] * static_cast<double>(weight(c, n, tap));
      }
      return static_cast<float>(sum);
    };
    pack_matrix(channels, columns, transformed, {}, out.subspan(f * step, step));
  }
}

std::size_t winograd_scratch(const WinogradConv& winograd) {
  return HWY_DYNAMIC_DISPATCH(scratch_floats)(winograd) + winograd.conv.upsampled.scratch_floats() +
         conv3x3_scratch(winograd.before);
}

void winograd_rows(const WinogradConv& winograd, int begin, int end, float* scratch) {
  HWY_DYNAMIC_DISPATCH(rows)(winograd, begin, end, scratch);
}

}  // namespace lcdm::kernels
#endif  // HWY_ONCE
