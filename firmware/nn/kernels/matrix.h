// Matrices as the register tile wants them: weights packed in panels, activations as strided rows.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>

#include "firmware/nn/network.h"

namespace lcdm::kernels {

// Columns are cut into panels of three vectors, the last ones of fewer where that comes out even:
// a panel of one vector keeps the multipliers least busy. A panel holds for each word of k its
// columns side by side, padded with zeros to whole vectors.
constexpr int panel_vectors(int vectors_left) {
  if (vectors_left == 4) return 2;
  return vectors_left < 3 ? vectors_left : 3;
}

// Consecutive k that share 32 bits of a panel, and of a row that meets it.
constexpr int numbers_per_word(Precision precision) {
  switch (precision) {
    case Precision::kFloat32:
      return 1;
    case Precision::kFloat16:
    case Precision::kBfloat16:
      return 2;
    case Precision::kInt8:
      return 4;
  }
  return 1;
}

// Rows that are made narrow together: bytes of one range, or halves of one scale. Who shares a
// range must not depend on the number of workers: a slice of a product begins at a multiple of it,
// or at an image row or a strip that is multiplied by itself.
inline constexpr int kRowsOfRange = 8;
// Words of rows that are held narrow at a time: half of a first cache of 32 KB. Rows of one range
// must fit, so a narrow matrix has at most kNarrowWords / kRowsOfRange words of depth.
inline constexpr int kNarrowWords = 4096;
// Whether rows of so many numbers, in so many runs, can be made words of that precision. Several
// runs come as words already (NarrowInput).
constexpr bool rows_fit(int depth, Precision precision, int runs = 1) {
  if (precision == Precision::kFloat32) return true;
  const int per_word = numbers_per_word(precision);
  if (runs > 1) return depth / runs % per_word == 0;
  return depth % per_word == 0 && depth / per_word <= kNarrowWords / kRowsOfRange;
}

// Borrowed: the engine owns the packed block.
struct PackedMatrix {
  const float* panels = nullptr;  // words of `precision`
  const float* bias = nullptr;    // [columns rounded up to whole vectors], as the next two
  int depth = 0;                  // K
  int columns = 0;                // N
  Precision precision = Precision::kFloat32;
  const float* scale = nullptr;  // kInt8, kFloat16: weight = scale * narrow
  // kInt8: of each column's weights, as they were rounded; for each run of a row, as the next says.
  const float* sums = nullptr;
  std::ptrdiff_t sums_pitch = 0;  // from one run's to the next
};

// Floats in a vector on this processor; packing depends on it.
int vector_lanes();
// How products of that precision are made on this processor. An AVX-512 processor without the
// instructions has no other path for them.
enum class Support : std::uint8_t { kNone, kSlow, kNative };
Support support_of(Precision precision);
// From now on as on an AVX-512 processor without products of bfloat16, or with them again
// (force_isa).
void forgo_bfloat16(bool forgone);
// The one asked for where it is native, else the next more exact one.
Precision native_precision(Precision wanted);
// The same for rows of `depth` numbers in so many runs: they must fit it too.
Precision native_precision(Precision wanted, int depth, int runs = 1);
// Floats that pack_matrix writes: panels, bias, and scale and sums where there are some.
std::size_t packed_floats(int depth, int columns, Precision precision = Precision::kFloat32,
                          int runs = 1);
// Packs weight(k, n) and bias[n] (empty: zeros) into `out` and returns the view of it. Rows of
// `depth` numbers in `runs` runs fit the precision.
PackedMatrix pack_matrix(int depth, int columns, const std::function<float(int, int)>& weight,
                         std::span<const float> bias, std::span<float> out,
                         Precision precision = Precision::kFloat32, int runs = 1);

// Rows to multiply: row m is the concatenation of `runs` pieces, each `run_length` floats from
// run[r] + m * stride. runs * run_length is the matrix's depth.
struct RowInput {
  const float* run[3] = {};
  int runs = 1;
  int run_length = 0;
  std::ptrdiff_t stride = 0;
  int rows = 0;
  // Whether every two rows share the words of the first, as row_winograd-inl.h says; the matrix is
  // pack_row_winograd's.
  bool transformed = false;

  // Whether the rows are windows of three pixels, each a pixel further: a 3x3 convolution's.
  bool are_windows() const { return run_length == 3 * stride; }
};

// What narrow numbers mean: number = low + scale * narrow. Low is 0 but for bytes.
struct RowRange {
  float low = 0;
  float scale = 0;
};

// Rows of words of the matrix's precision: lengths and strides are in words, and each run has one
// range for all its rows.
struct NarrowInput {
  RowInput words;
  std::array<RowRange, 3> ranges;
};

// Where the products go: row m at data + m * stride, the residual (or null) alike.
struct RowOutput {
  float* data = nullptr;
  const float* residual = nullptr;
  std::ptrdiff_t stride = 0;
  Activation activation = Activation::kNone;
  // Rows two by two as words of bfloat16, the first of them in the lower half, a missing second one
  // 0; the stride is from pair to pair. Without a residual; of narrow products with SiLU, and of
  // halves of no more than a vector of columns without activation: other rows do not come in pairs.
  bool paired = false;
};

// out = activation(a * b + bias + residual), over all rows of `a`. Where the matrix is narrow, rows
// of one run, side by side, are made so on the way, kRowsOfRange at a time: results depend on which
// those are.
void multiply_rows(const RowInput& a, const PackedMatrix& b, const RowOutput& out);

// `count` numbers as words; whole ones.
RowRange narrow_row(const float* from, int count, Precision precision, float* words);
// The same as multiply_rows, of rows that are words of the matrix's precision already.
void multiply_narrow_rows(const NarrowInput& a, const PackedMatrix& b, const RowOutput& out);

}  // namespace lcdm::kernels
