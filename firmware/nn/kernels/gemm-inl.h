// The register tile under every convolution, linear layer and attention product.
#if defined(LCDM_KERNELS_GEMM_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef LCDM_KERNELS_GEMM_INL_H
#undef LCDM_KERNELS_GEMM_INL_H
#else
#define LCDM_KERNELS_GEMM_INL_H
#endif

#include <cstddef>
#include <cstring>

#include "firmware/nn/kernels/math-inl.h"
#include "firmware/nn/kernels/matrix.h"

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
// row, of which vectors of tag d are used.
template <int MR, int NV, class D>
HWY_INLINE void accumulate(D d, const float* a, std::ptrdiff_t row_stride, std::ptrdiff_t k_stride,
                           int depth, const float* b, hn::Vec<D> (&acc)[MR][NV]) {
  const float* row[MR];
  LCDM_UNROLL for (int m = 0; m < MR; ++m) row[m] = a + m * row_stride;
  for (std::ptrdiff_t k = 0; k < depth * k_stride; k += k_stride, b += NV * kLanes) {
    hn::Vec<D> w[NV];
    LCDM_UNROLL for (int v = 0; v < NV; ++v) w[v] = hn::LoadU(d, b + v * kLanes);
    LCDM_UNROLL for (int m = 0; m < MR; ++m) {
      const auto x = hn::Set(d, row[m][k]);
      LCDM_UNROLL for (int v = 0; v < NV; ++v) acc[m][v] = hn::MulAdd(x, w[v], acc[m][v]);
    }
  }
}

// Residual, activation, store: `columns` of the tile's NV vectors are real.
template <Activation kActivation, int MR, int NV, class D>
HWY_INLINE void finish(D d, const RowOutput& o, int row, int column, int columns,
                       hn::Vec<D> (&acc)[MR][NV]) {
  constexpr std::size_t kWidth = sizeof(hn::Vec<D>) / sizeof(float);
  LCDM_UNROLL for (int m = 0; m < MR; ++m) {
    const std::ptrdiff_t at = (row + m) * o.stride + column;
    LCDM_UNROLL for (int v = 0; v < NV; ++v) {
      const int first = v * static_cast<int>(kWidth);
      const auto left = static_cast<std::size_t>(columns - first);
      if (left >= kWidth) {
        if (o.residual != nullptr) {
          acc[m][v] = hn::Add(acc[m][v], hn::LoadU(d, o.residual + at + first));
        }
        hn::StoreU(activate<kActivation>(d, acc[m][v]), d, o.data + at + first);
      } else {
        HWY_ALIGN float part[kWidth] = {};
        if (o.residual != nullptr) {
          std::memcpy(part, o.residual + at + first, left * sizeof(float));
          acc[m][v] = hn::Add(acc[m][v], hn::Load(d, part));
        }
        hn::Store(activate<kActivation>(d, acc[m][v]), d, part);
        std::memcpy(o.data + at + first, part, left * sizeof(float));
      }
    }
  }
}

// One tile of MR rows of one panel.
template <int MR, int NV, class D>
HWY_NOINLINE void tile(D d, const RowInput& a, int row, const float* panel, const float* bias,
                       const RowOutput& o, int column, int columns) {
  hn::Vec<D> acc[MR][NV];
  LCDM_UNROLL for (int m = 0; m < MR; ++m) {
    LCDM_UNROLL for (int v = 0; v < NV; ++v) acc[m][v] = hn::LoadU(d, bias + v * kLanes);
  }
  for (int r = 0; r < a.runs; ++r) {
    accumulate<MR, NV>(d, a.run[r] + row * a.stride, a.stride, 1, a.run_length,
                       panel + static_cast<std::size_t>(r) * a.run_length * NV * kLanes, acc);
  }
  with_activation(o.activation, [&](auto kind) HWY_ATTR {
    finish<decltype(kind)::value, MR, NV>(d, o, row, column, columns, acc);
  });
}

// All rows of one panel: full tiles, then halves of them.
template <int NV, class D>
HWY_INLINE void panel_rows(D d, const RowInput& a, const float* panel, const float* bias,
                           const RowOutput& o, int column, int columns) {
  constexpr int kRows = tile_rows<NV>();
  int row = 0;
  for (; row + kRows <= a.rows; row += kRows) {
    tile<kRows, NV>(d, a, row, panel, bias, o, column, columns);
  }
  if constexpr (kRows > 4) {
    for (; row + 4 <= a.rows; row += 4) tile<4, NV>(d, a, row, panel, bias, o, column, columns);
  }
  for (; row + 2 <= a.rows; row += 2) tile<2, NV>(d, a, row, panel, bias, o, column, columns);
  for (; row < a.rows; ++row) tile<1, NV>(d, a, row, panel, bias, o, column, columns);
}

// o[row][n] = activation(bias[n] + sum over runs and k of a * b + residual).
HWY_INLINE void multiply(const RowInput& a, const PackedMatrix& b, const RowOutput& o) {
  const int panel_columns = kPanelVectors * static_cast<int>(kLanes);
  for (int column = 0; column < b.columns; column += panel_columns) {
    const float* panel = b.panels + static_cast<std::size_t>(column) * b.depth;
    const float* bias = b.bias + column;
    const int columns = b.columns - column;
    const FullTag d;
    const HWY_CAPPED(float, 8) eight;
    if (columns > 2 * static_cast<int>(kLanes)) {
      panel_rows<3>(d, a, panel, bias, o, column, columns);
    } else if (columns > static_cast<int>(kLanes)) {
      panel_rows<2>(d, a, panel, bias, o, column, columns);
    } else if (kLanes > 8 && columns <= 8) {
      panel_rows<1>(eight, a, panel, bias, o, column, columns);  // half a vector costs half
    } else {
      panel_rows<1>(d, a, panel, bias, o, column, columns);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#endif
