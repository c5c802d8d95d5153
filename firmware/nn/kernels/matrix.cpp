#include "firmware/nn/kernels/matrix.h"

#include <algorithm>

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "firmware/nn/kernels/matrix.cpp"
#include "firmware/nn/kernels/simd.h"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
#include "firmware/nn/kernels/gemm-inl.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

// Rows that are multiplied with every panel before the next rows: they stay in the second cache.
constexpr int kBlockRows = 64;

void multiply_blocks(const RowInput& a, const PackedMatrix& b, const RowOutput& o) {
  for (int row = 0; row < a.rows; row += kBlockRows) {
    RowInput block = a;
    for (int r = 0; r < a.runs; ++r) block.run[r] = a.run[r] + row * a.stride;
    block.rows = std::min(kBlockRows, a.rows - row);
    RowOutput out = o;
    out.data = o.data + row * o.stride;
    if (o.residual != nullptr) out.residual = o.residual + row * o.stride;
    multiply(block, b, out);
  }
}

int lanes() { return static_cast<int>(kLanes); }

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm::kernels {

HWY_EXPORT(multiply_blocks);
HWY_EXPORT(lanes);

int vector_lanes() { return HWY_DYNAMIC_DISPATCH(lanes)(); }

namespace {

int padded(int columns) { return (columns + vector_lanes() - 1) / vector_lanes() * vector_lanes(); }

}  // namespace

std::size_t packed_floats(int depth, int columns) {
  return (static_cast<std::size_t>(depth) + 1) * static_cast<std::size_t>(padded(columns));
}

PackedMatrix pack_matrix(int depth, int columns, const std::function<float(int, int)>& weight,
                         std::span<const float> bias, std::span<float> out) {
  LCDM_CHECK(out.size() == packed_floats(depth, columns));
  const int panel = kPanelVectors * vector_lanes();
  std::size_t at = 0;
  for (int first = 0; first < columns; first += panel) {
    const int width = std::min(panel, padded(columns) - first);
    for (int k = 0; k < depth; ++k) {
      for (int n = first; n < first + width; ++n) out[at++] = n < columns ? weight(k, n) : 0.0F;
    }
  }
  const std::span<float> packed_bias = out.subspan(at);
  std::fill(packed_bias.begin(), packed_bias.end(), 0.0F);
  std::copy(bias.begin(), bias.end(), packed_bias.begin());
  return {out.data(), packed_bias.data(), depth, columns};
}

void multiply_rows(const RowInput& a, const PackedMatrix& b, const RowOutput& out) {
  LCDM_CHECK(a.runs * a.run_length == b.depth);
  HWY_DYNAMIC_DISPATCH(multiply_blocks)(a, b, out);
}

}  // namespace lcdm::kernels
#endif  // HWY_ONCE
