// Matrices as the register tile wants them: weights packed in panels, activations as strided rows.
#pragma once

#include <cstddef>
#include <functional>
#include <span>

#include "firmware/nn/network.h"

namespace lcdm::kernels {

// Columns are cut into panels of kPanelVectors vectors, the last one into as many as it needs.
// A panel holds for each k its columns side by side, padded with zeros to whole vectors.
inline constexpr int kPanelVectors = 3;

// Borrowed: the engine owns the packed block.
struct PackedMatrix {
  const float* panels = nullptr;
  const float* bias = nullptr;  // [columns rounded up to whole vectors]
  int depth = 0;                // K
  int columns = 0;              // N
};

// Floats in a vector on this processor; packing depends on it.
int vector_lanes();
// Floats that pack_matrix writes: panels, then bias.
std::size_t packed_floats(int depth, int columns);
// Packs weight(k, n) and bias[n] (empty: zeros) into `out` and returns the view of it.
PackedMatrix pack_matrix(int depth, int columns, const std::function<float(int, int)>& weight,
                         std::span<const float> bias, std::span<float> out);

// Rows to multiply: row m is the concatenation of `runs` pieces, each `run_length` floats from
// run[r] + m * stride. runs * run_length is the matrix's depth.
struct RowInput {
  const float* run[3] = {};
  int runs = 1;
  int run_length = 0;
  std::ptrdiff_t stride = 0;
  int rows = 0;
};

// The rows that a call was asked for. It may make those around them as well; they are other calls'
// to store, perhaps at this moment.
struct OwnRows {
  int begin = 0;
  int end = 0;

  bool has(int row) const { return row >= begin && row < end; }
};

// Where the products go: row m at data + m * stride, the residual (or null) alike.
struct RowOutput {
  float* data = nullptr;
  const float* residual = nullptr;
  std::ptrdiff_t stride = 0;
  Activation activation = Activation::kNone;
};

// out = activation(a * b + bias + residual), over all rows of `a`.
void multiply_rows(const RowInput& a, const PackedMatrix& b, const RowOutput& out);

}  // namespace lcdm::kernels
