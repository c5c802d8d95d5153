// The register tile under every convolution, linear layer and attention product. Compiled where
// matrix.h's calls are, and in attention, which has rows of its own.
#if defined(LCDM_KERNELS_GEMM_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef LCDM_KERNELS_GEMM_INL_H
#undef LCDM_KERNELS_GEMM_INL_H
#else
#define LCDM_KERNELS_GEMM_INL_H
#endif

#include <cstddef>
#include <cstring>

#include "firmware/nn/kernels/bfloat16-inl.h"
#include "firmware/nn/kernels/float16-inl.h"
#include "firmware/nn/kernels/int8-inl.h"
#include "firmware/nn/kernels/math-inl.h"
#include "firmware/nn/kernels/matrix.h"
#include "firmware/nn/kernels/operand-inl.h"
#include "firmware/nn/kernels/row_winograd-inl.h"

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

// Rows of a tile `NV` vectors wide: as many as the registers hold beside one row of weights.
template <int NV>
constexpr int tile_rows() {
#if HWY_TARGET == HWY_AVX2 || HWY_TARGET == HWY_SSE4
  return NV == 1 ? 8 : 4;  // 16 registers
#else
  return 8;
#endif
}

// acc[m][v] += sum over k of a[m * row_stride + k * k_stride] * b[k][v], in the order of k whatever
// the tile: so results do not depend on how rows are cut into tiles. b is packed, NV full vectors a
// row, of which vectors of tag d are used. k counts words of the operand, `depth` of them.
template <class Operand, int MR, int NV, class D>
HWY_INLINE void accumulate_block(D d, const float* a, std::ptrdiff_t row_stride,
                                 std::ptrdiff_t k_stride, int depth, const float* b,
                                 hn::Vec<D> (&acc)[MR][NV]) {
  const float* row[MR];
  LCDM_UNROLL for (int m = 0; m < MR; ++m) row[m] = a + m * row_stride;
  for (std::ptrdiff_t k = 0; k < depth * k_stride; k += k_stride, b += NV * kLanes) {
    hn::Vec<D> w[NV];
    LCDM_UNROLL for (int v = 0; v < NV; ++v) w[v] = hn::LoadU(d, b + v * kLanes);
    LCDM_UNROLL for (int m = 0; m < MR; ++m) {
      const auto x = hn::Set(d, row[m][k]);
      LCDM_UNROLL for (int v = 0; v < NV; ++v) acc[m][v] = Operand::dot(d, x, w[v], acc[m][v]);
    }
  }
}

// The same for one vector of columns and rows that are the windows of a 3x3 convolution: each
// begins one pixel of `pixel` words after the one before and is three pixels long. A word is
// broadcast once for the three windows that see it; the sums are in another order of k, again
// whatever the tile.
template <class Operand, int MR, class D>
HWY_INLINE void accumulate_windows(D d, const float* a, std::ptrdiff_t pixel, const float* b,
                                   hn::Vec<D> (&acc)[MR][1]) {
  const std::ptrdiff_t tap = pixel * static_cast<std::ptrdiff_t>(kLanes);
  for (std::ptrdiff_t k = 0; k < pixel; ++k, b += kLanes) {
    const hn::Vec<D> w[3] = {hn::LoadU(d, b), hn::LoadU(d, b + tap), hn::LoadU(d, b + 2 * tap)};
    const float* at = a + k;
    LCDM_UNROLL for (int column = 0; column < MR + 2; ++column, at += pixel) {
      const auto x = hn::Set(d, *at);
      LCDM_UNROLL for (int t = 0; t < 3; ++t) {
        const int m = column - t;
        if (m >= 0 && m < MR) acc[m][0] = Operand::dot(d, x, w[t], acc[m][0]);
      }
    }
  }
}

// The same block by block, where the operand's own sums must stay short.
template <class Operand, int MR, int NV, class D>
HWY_INLINE void accumulate(D d, const float* a, std::ptrdiff_t row_stride, std::ptrdiff_t k_stride,
                           int depth, const float* b, hn::Vec<D> (&acc)[MR][NV]) {
  if constexpr (Operand::kBlock == 0) {
    accumulate_block<Operand, MR, NV>(d, a, row_stride, k_stride, depth, b, acc);
  } else {
    constexpr std::ptrdiff_t kVectors = NV * static_cast<std::ptrdiff_t>(kLanes);
    for (int k = 0; k < depth; k += Operand::kBlock) {
      const int words = depth - k < Operand::kBlock ? depth - k : Operand::kBlock;
      hn::Vec<D> part[MR][NV];
      LCDM_UNROLL for (int m = 0; m < MR; ++m) {
        LCDM_UNROLL for (int v = 0; v < NV; ++v) part[m][v] = hn::Zero(d);
      }
      accumulate_block<Operand, MR, NV>(d, a + k * k_stride, row_stride, k_stride, words,
                                        b + k * kVectors, part);
      LCDM_UNROLL for (int m = 0; m < MR; ++m) {
        LCDM_UNROLL for (int v = 0; v < NV; ++v) {
          acc[m][v] = hn::Add(acc[m][v], Operand::widened(d, part[m][v]));
        }
      }
    }
  }
}

// Residual, activation, store, where all of the tile's columns are real.
template <Activation kActivation, bool kRough, int MR, int NV, class D>
HWY_INLINE void finish_whole(D d, const RowOutput& o, int row, int column,
                             hn::Vec<D> (&acc)[MR][NV]) {
  constexpr std::ptrdiff_t kWidth = sizeof(hn::Vec<D>) / sizeof(float);
  const std::ptrdiff_t at = row * o.stride + column;
  if (o.residual != nullptr) {
    const float* residual = o.residual + at;
    LCDM_UNROLL for (int m = 0; m < MR; ++m, residual += o.stride) {
      LCDM_UNROLL for (int v = 0; v < NV; ++v) {
        acc[m][v] = hn::Add(acc[m][v], hn::LoadU(d, residual + v * kWidth));
      }
    }
  }
  float* to = o.data + at;
  LCDM_UNROLL for (int m = 0; m < MR; ++m, to += o.stride) {
    LCDM_UNROLL for (int v = 0; v < NV; ++v) {
      hn::StoreU(activate<kActivation, kRough>(d, acc[m][v]), d, to + v * kWidth);
    }
  }
}

// The same where `columns` of the tile's NV vectors are real.
template <Activation kActivation, bool kRough, int MR, int NV, class D>
HWY_INLINE void finish(D d, const RowOutput& o, int row, int column, int columns,
                       hn::Vec<D> (&acc)[MR][NV]) {
  constexpr std::size_t kWidth = sizeof(hn::Vec<D>) / sizeof(float);
  if (columns >= NV * static_cast<int>(kWidth)) {
    return finish_whole<kActivation, kRough>(d, o, row, column, acc);
  }
  LCDM_UNROLL for (int m = 0; m < MR; ++m) {
    const std::ptrdiff_t at = (row + m) * o.stride + column;
    LCDM_UNROLL for (int v = 0; v < NV; ++v) {
      const int first = v * static_cast<int>(kWidth);
      const auto left = static_cast<std::size_t>(columns - first);
      if (left >= kWidth) {
        if (o.residual != nullptr) {
          acc[m][v] = hn::Add(acc[m][v], hn::LoadU(d, o.residual + at + first));
        }
        hn::StoreU(activate<kActivation, kRough>(d, acc[m][v]), d, o.data + at + first);
      } else {
        HWY_ALIGN float part[kWidth] = {};
        if (o.residual != nullptr) {
          std::memcpy(part, o.residual + at + first, left * sizeof(float));
          acc[m][v] = hn::Add(acc[m][v], hn::Load(d, part));
        }
        hn::Store(activate<kActivation, kRough>(d, acc[m][v]), d, part);
        std::memcpy(o.data + at + first, part, left * sizeof(float));
      }
    }
  }
}

// Activation and store of rows in pairs, without a residual.
template <Activation kActivation, int MR, int NV, class D>
HWY_INLINE void finish_pairs(D d, const RowOutput& o, int row, int column, int columns,
                             hn::Vec<D> (&acc)[MR][NV]) {
  constexpr std::ptrdiff_t kWidth = sizeof(hn::Vec<D>) / sizeof(float);
  const auto words = [&](int m, int v) HWY_ATTR {
    const auto first = activate<kActivation, true>(d, acc[m][v]);
    auto second = hn::Zero(d);
    if (m + 1 < MR) second = activate<kActivation, true>(d, acc[m + 1][v]);
    return Bfloat16Operand::pair(d, first, second);
  };
  float* to = o.data + row / 2 * o.stride + column;
  if (columns >= NV * kWidth) {
    LCDM_UNROLL for (int m = 0; m < MR; m += 2, to += o.stride) {
      LCDM_UNROLL for (int v = 0; v < NV; ++v) hn::StoreU(words(m, v), d, to + v * kWidth);
    }
    return;
  }
  HWY_ALIGN float part[NV * kWidth];
  LCDM_UNROLL for (int m = 0; m < MR; m += 2, to += o.stride) {
    LCDM_UNROLL for (int v = 0; v < NV; ++v) hn::Store(words(m, v), d, part + v * kWidth);
    std::memcpy(to, part, static_cast<std::size_t>(columns) * sizeof(float));
  }
}

// Rows as words of the operand: those of a RowInput. Where the operand is scaled, every run has
// ranges of its own: one for all rows, or, of a single run, one for every kRowsOfRange rows.
struct Words {
  RowInput rows;
  const RowRange* ranges = nullptr;
  bool shared = false;  // one for all rows

  const RowRange& range(int run, int row) const {
    return ranges[shared ? run : row / kRowsOfRange];
  }
};

// Where a panel stands in its matrix.
struct Panel {
  const PackedMatrix& matrix;
  int column;

  template <class Operand>
  HWY_INLINE const float* words() const {
    constexpr int kPerWord = numbers_per_word(Operand::kPrecision);
    return matrix.panels + static_cast<std::size_t>(column) * (matrix.depth / kPerWord);
  }
  std::ptrdiff_t at(int v) const { return column + v * static_cast<std::ptrdiff_t>(kLanes); }
};

// What sums in float begin with: the bias, and what the ranges of bytes begin at, since (low +
// scale * byte) * weight summed is scale * (bytes * weight) + low * sum.
template <class Operand, class D>
HWY_INLINE hn::Vec<D> first_sum(D d, const Panel& panel, int v, const Words& a, int row) {
  auto sum = hn::LoadU(d, panel.matrix.bias + panel.at(v));
  if constexpr (Operand::kPrecision == Precision::kInt8) {
    const float* sums = panel.matrix.sums + panel.at(v);
    for (int r = 0; r < a.rows.runs; ++r, sums += panel.matrix.sums_pitch) {
      sum = hn::MulAdd(hn::Set(d, a.range(r, row).low), hn::LoadU(d, sums), sum);
    }
  }
  return sum;
}

// The same of one run, in the operand's units, as floats.
template <class Operand, int MR, int NV, class D>
HWY_INLINE void multiply_run(D d, const Words& a, int row, int r, const Panel& panel,
                             hn::Vec<D> (&acc)[MR][NV]) {
  const RowInput& rows = a.rows;
  const float* run = rows.run[r] + row * rows.stride;
  const float* words =
      panel.words<Operand>() + static_cast<std::size_t>(r) * rows.run_length * NV * kLanes;
  if constexpr (NV == 1 && Operand::kBlock == 0) {
    if (rows.are_windows()) {
      return accumulate_windows<Operand, MR>(d, run, rows.stride, words, acc);
    }
  }
  accumulate<Operand, MR, NV>(d, run, rows.stride, 1, rows.run_length, words, acc);
}

// acc += scale * the sums of run r, which are in units of its range and of the columns; the first
// run begins acc. A tile's rows are of one range: tiles do not cross a multiple of kRowsOfRange.
template <class Operand, bool kFirst, int MR, int NV, class D>
HWY_INLINE void add_scaled_run(D d, const Words& a, int row, int r, const Panel& panel,
                               hn::Vec<D> (&acc)[MR][NV]) {
  hn::Vec<D> part[MR][NV];
  LCDM_UNROLL for (int m = 0; m < MR; ++m) {
    LCDM_UNROLL for (int v = 0; v < NV; ++v) part[m][v] = hn::Zero(d);
  }
  multiply_run<Operand, MR, NV>(d, a, row, r, panel, part);
  const auto of_rows = hn::Set(d, a.range(r, row).scale);
  LCDM_UNROLL for (int v = 0; v < NV; ++v) {
    const auto scale = hn::Mul(of_rows, hn::LoadU(d, panel.matrix.scale + panel.at(v)));
    const auto first = kFirst ? first_sum<Operand>(d, panel, v, a, row) : hn::Zero(d);
    LCDM_UNROLL for (int m = 0; m < MR; ++m) {
      if constexpr (Operand::kPrecision == Precision::kInt8) {
        const hn::RebindToSigned<D> di;
        part[m][v] = hn::ConvertTo(d, hn::BitCast(di, part[m][v]));
      }
      acc[m][v] = hn::MulAdd(part[m][v], scale, kFirst ? first : acc[m][v]);
    }
  }
}

// What row_winograd_pays may choose: larger tiles are compiled without it, those of 16 rows, which
// are windows, among them.
template <class Operand, int MR, int NV>
constexpr bool can_be_transformed() {
  return !Operand::kScaled && kLanes != kRowWinogradNotLanes && MR <= tile_rows<NV>() &&
         NV * kLanes <= kRowWinogradColumns;
}

// acc = the bias and the products of all runs.
template <class Operand, int MR, int NV, class D>
HWY_INLINE void multiply_runs(D d, const Words& a, int row, const Panel& panel,
                              hn::Vec<D> (&acc)[MR][NV]) {
  if constexpr (can_be_transformed<Operand, MR, NV>()) {
    if (a.rows.transformed) {
      return multiply_transformed<Operand>(d, a.rows, row, panel.words<Operand>(),
                                           panel.matrix.bias + panel.at(0), acc);
    }
  }
  if constexpr (Operand::kScaled) {
    add_scaled_run<Operand, true, MR, NV>(d, a, row, 0, panel, acc);
    for (int r = 1; r < a.rows.runs; ++r) {
      add_scaled_run<Operand, false, MR, NV>(d, a, row, r, panel, acc);
    }
  } else {
    LCDM_UNROLL for (int m = 0; m < MR; ++m) {
      LCDM_UNROLL for (int v = 0; v < NV; ++v) {
        acc[m][v] = hn::LoadU(d, panel.matrix.bias + panel.at(v));
      }
    }
    for (int r = 0; r < a.rows.runs; ++r) multiply_run<Operand, MR, NV>(d, a, row, r, panel, acc);
  }
}

// What is asked for in pairs: an inverted residual's expansion, and conv1 of the head's condition.
// Compiled into every narrow tile it cost int8 6 % of a frame.
template <class Operand, int NV>
constexpr bool can_be_paired(Activation activation) {
  if (Operand::kPrecision == Precision::kFloat32) return false;
  if (activation == Activation::kSilu) return true;
  return activation == Activation::kNone && Operand::kPrecision == Precision::kBfloat16 && NV == 1;
}

// One tile of MR rows of one panel.
template <class Operand, int MR, int NV, class D>
HWY_NOINLINE void tile(D d, const Words& a, int row, const Panel& panel, const RowOutput& o) {
  hn::Vec<D> acc[MR][NV];
  multiply_runs<Operand, MR, NV>(d, a, row, panel, acc);
  with_activation(o.activation, [&](auto kind) HWY_ATTR {
    constexpr bool kRough = Operand::kPrecision != Precision::kFloat32;
    constexpr Activation kKind = decltype(kind)::value;
    const int columns = panel.matrix.columns - panel.column;
    if constexpr (can_be_paired<Operand, NV>(kKind)) {
      if (o.paired) return finish_pairs<kKind>(d, o, row, panel.column, columns, acc);
    }
    finish<kKind, kRough>(d, o, row, panel.column, columns, acc);
  });
}

// All rows of one panel: full tiles, then halves of them.
template <class Operand, int NV, class D>
HWY_INLINE void panel_rows(D d, const Words& a, const Panel& panel, const RowOutput& o) {
  constexpr int kRows = tile_rows<NV>();
  const int count = a.rows.rows;
  int row = 0;
  // 32 registers: sixteen windows beside their words.
  if constexpr (NV == 1 && HWY_TARGET == HWY_AVX3) {
    if (a.rows.are_windows()) {
      for (; row + 16 <= count; row += 16) tile<Operand, 16, NV>(d, a, row, panel, o);
    }
  }
  for (; row + kRows <= count; row += kRows) tile<Operand, kRows, NV>(d, a, row, panel, o);
  if constexpr (kRows > 4) {
    for (; row + 4 <= count; row += 4) tile<Operand, 4, NV>(d, a, row, panel, o);
  }
  for (; row + 2 <= count; row += 2) tile<Operand, 2, NV>(d, a, row, panel, o);
  for (; row < count; ++row) tile<Operand, 1, NV>(d, a, row, panel, o);
}

// o[row][n] = activation(bias[n] + sum over runs and k of a * b + residual), of rows that are words
// of the matrix's own operand.
template <class Operand>
HWY_INLINE void multiply_block(const Words& a, const PackedMatrix& b, const RowOutput& o) {
  constexpr int kWidth = static_cast<int>(kLanes);
  int vectors = 0;
  for (int column = 0; column < b.columns; column += vectors * kWidth) {
    const Panel panel = {b, column};
    const int columns = b.columns - column;
    vectors = panel_vectors((columns + kWidth - 1) / kWidth);
    const FullTag d;
    const HWY_CAPPED(float, 8) eight;
    if (vectors == 3) {
      panel_rows<Operand, 3>(d, a, panel, o);
    } else if (vectors == 2) {
      panel_rows<Operand, 2>(d, a, panel, o);
    } else if (kLanes > 8 && columns <= 8) {
      panel_rows<Operand, 1>(eight, a, panel, o);  // half a vector costs half
    } else {
      panel_rows<Operand, 1>(d, a, panel, o);
    }
  }
}

HWY_INLINE RowOutput rows_from(RowOutput o, std::ptrdiff_t row) {
  o.data += (o.paired ? row / 2 : row) * o.stride;
  if (o.residual != nullptr) o.residual += row * o.stride;
  return o;
}

// The same of rows of floats in one run, side by side, made narrow some at a time: whole ranges of
// them.
template <class Operand>
HWY_NOINLINE void multiply_narrowed(const RowInput& a, const PackedMatrix& b, const RowOutput& o) {
  constexpr int kMostRows = 128;
  HWY_ALIGN float words[kNarrowWords];
  RowRange ranges[kMostRows / kRowsOfRange];
  const int row_words = b.depth / numbers_per_word(b.precision);
  const int fitting = kNarrowWords / row_words / kRowsOfRange * kRowsOfRange;  // by pack_matrix > 0
  const int block = fitting < kMostRows ? fitting : kMostRows;
  for (int row = 0; row < a.rows; row += block) {
    const int rows = a.rows - row < block ? a.rows - row : block;
    for (int m = 0; m < rows; m += kRowsOfRange) {
      const int together = rows - m < kRowsOfRange ? rows - m : kRowsOfRange;
      ranges[m / kRowsOfRange] =
          Operand::narrow_rows(a.run[0] + (row + m) * a.stride, together * b.depth,
                               words + static_cast<std::ptrdiff_t>(m) * row_words);
    }
    const Words narrow = {{{words}, 1, row_words, row_words, rows}, ranges};
    multiply_block<Operand>(narrow, b, rows_from(o, row));
  }
}

// The same of rows that are words already.
template <class Operand>
HWY_NOINLINE void multiply_words(const NarrowInput& a, const PackedMatrix& b, const RowOutput& o) {
  multiply_block<Operand>({a.words, a.ranges.data(), true}, b, o);
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#endif
