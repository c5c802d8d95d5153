#include "firmware/nn/kernels/matrix.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>

#include "firmware/base/os.h"
#include "firmware/nn/kernels/words.h"

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

HWY_INLINE void multiply_blocks(const RowInput& a, const PackedMatrix& b, const RowOutput& o) {
  for (int row = 0; row < a.rows; row += kBlockRows) {
    RowInput block = a;
    for (int r = 0; r < a.runs; ++r) block.run[r] = a.run[r] + row * a.stride;
    block.rows = std::min(kBlockRows, a.rows - row);
    multiply_block<FloatOperand>({block, nullptr}, b, rows_from(o, row));
  }
}

void rows_of_floats(const RowInput& a, const PackedMatrix& b, const RowOutput& o) {
  switch (b.precision) {
    case Precision::kFloat32:
      return multiply_blocks(a, b, o);
    case Precision::kBfloat16:
      return multiply_narrowed<Bfloat16Operand>(a, b, o);
    case Precision::kInt8:
      return multiply_narrowed<Int8Operand>(a, b, o);
  }
}

int lanes() { return static_cast<int>(kLanes); }

bool is_native(Precision precision) {
  switch (precision) {
    case Precision::kFloat32:
      return true;
    case Precision::kBfloat16:
      return LCDM_NATIVE_BFLOAT16;
    case Precision::kInt8:
      return LCDM_NATIVE_INT8;
  }
  return false;
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm::kernels {

HWY_EXPORT(rows_of_floats);
HWY_EXPORT(lanes);
HWY_EXPORT(is_native);

int vector_lanes() { return HWY_DYNAMIC_DISPATCH(lanes)(); }

namespace {

int padded(int columns) { return (columns + vector_lanes() - 1) / vector_lanes() * vector_lanes(); }

// AVX-512 and NEON are older than these instructions of theirs.
bool processor_has(Precision precision) {
#if defined(__x86_64__)
  return precision == Precision::kBfloat16 ? __builtin_cpu_supports("avx512bf16") != 0
                                           : __builtin_cpu_supports("avx512vnni") != 0;
#else
  return precision == Precision::kInt8 && os::has_dot_product();
#endif
}

}  // namespace

Support support_of(Precision precision) {
  if (precision == Precision::kFloat32) return Support::kNative;
  if (!HWY_DYNAMIC_DISPATCH(is_native)(precision)) return Support::kSlow;
  return processor_has(precision) ? Support::kNative : Support::kNone;
}

Precision native_precision(Precision wanted) {
  // Rows of a word each, which fit wherever rows may.
  return native_precision(wanted, numbers_per_word(Precision::kInt8));
}

Precision native_precision(Precision wanted, int depth) {
  for (const Precision precision : {Precision::kInt8, Precision::kBfloat16}) {
    const bool fits = wanted >= precision && rows_fit(depth, precision);
    if (fits && support_of(precision) == Support::kNative) return precision;
  }
  return Precision::kFloat32;
}

std::size_t packed_floats(int depth, int columns, Precision precision) {
  const int words = depth / numbers_per_word(precision);
  const int vectors = precision == Precision::kInt8 ? 3 : 1;  // bias, scale, sums
  return static_cast<std::size_t>(words + vectors) * static_cast<std::size_t>(padded(columns));
}

namespace {

using Weight = std::function<float(int, int)>;

float word_of_bits(std::uint32_t bits) { return std::bit_cast<float>(bits); }

// word(k, n) begins at number k of column n.
template <typename Word>
std::span<float> pack_panels(int depth, int columns, int per_word, std::span<float> out,
                             const Word& word) {
  const int panel = kPanelVectors * vector_lanes();
  std::size_t at = 0;
  for (int first = 0; first < columns; first += panel) {
    const int width = std::min(panel, padded(columns) - first);
    for (int k = 0; k < depth; k += per_word) {
      for (int n = first; n < first + width; ++n) out[at++] = n < columns ? word(k, n) : 0.0F;
    }
  }
  return out.subspan(at);
}

struct ColumnScale {
  float scale = 0;
  float sum = 0;
};

int rounded(float weight, float scale) {
  return scale > 0 ? static_cast<int>(std::lround(weight / scale)) : 0;
}

// One scale, by the largest weight, and the sum of what remains of the weights.
ColumnScale scale_column(int depth, int n, const Weight& weight) {
  float largest = 0;
  for (int k = 0; k < depth; ++k) largest = std::max(largest, std::fabs(weight(k, n)));
  const float scale = largest / 127.0F;
  int sum = 0;
  for (int k = 0; k < depth; ++k) sum += rounded(weight(k, n), scale);
  return {scale, scale * static_cast<float>(sum)};
}

std::uint32_t int8_quad(int k, int n, float scale, const Weight& weight) {
  std::uint32_t bits = 0;
  for (int i = 0; i < 4; ++i) {
    const auto byte = static_cast<std::uint8_t>(rounded(weight(k + i, n), scale));
    bits |= static_cast<std::uint32_t>(byte) << (8 * i);
  }
  return bits;
}

}  // namespace

PackedMatrix pack_matrix(int depth, int columns, const Weight& weight, std::span<const float> bias,
                         std::span<float> out, Precision precision) {
  LCDM_CHECK(out.size() == packed_floats(depth, columns, precision));
  const int per_word = numbers_per_word(precision);
  LCDM_CHECK(rows_fit(depth, precision));
  const auto width = static_cast<std::size_t>(padded(columns));
  PackedMatrix matrix = {out.data(), nullptr, depth, columns, precision};
  std::span<float> rest;
  if (precision == Precision::kFloat32) {
    rest = pack_panels(depth, columns, per_word, out, weight);
  } else if (precision == Precision::kBfloat16) {
    rest = pack_panels(depth, columns, per_word, out, [&](int k, int n) {
      return word_of_bits(bfloat16_pair(weight(k, n), weight(k + 1, n)));
    });
  } else {
    const std::span<float> rest_of_columns = out.last(2 * width);
    const std::span<float> scale = rest_of_columns.first(width);
    const std::span<float> sums = rest_of_columns.last(width);
    std::fill(rest_of_columns.begin(), rest_of_columns.end(), 0.0F);
    for (int n = 0; n < columns; ++n) {
      const ColumnScale column = scale_column(depth, n, weight);
      scale[static_cast<std::size_t>(n)] = column.scale;
      sums[static_cast<std::size_t>(n)] = column.sum;
    }
    rest = pack_panels(depth, columns, per_word, out, [&](int k, int n) {
      return word_of_bits(int8_quad(k, n, scale[static_cast<std::size_t>(n)], weight));
    });
    matrix.scale = scale.data();
    matrix.sums = sums.data();
  }
  const std::span<float> packed_bias = rest.first(width);
  std::fill(packed_bias.begin(), packed_bias.end(), 0.0F);
  std::copy(bias.begin(), bias.end(), packed_bias.begin());
  matrix.bias = packed_bias.data();
  return matrix;
}

void multiply_rows(const RowInput& a, const PackedMatrix& b, const RowOutput& out) {
  LCDM_CHECK(a.runs * a.run_length == b.depth);
  LCDM_CHECK(a.runs == 1 || b.precision == Precision::kFloat32);
  HWY_DYNAMIC_DISPATCH(rows_of_floats)(a, b, out);
}

}  // namespace lcdm::kernels
#endif  // HWY_ONCE
