#include "firmware/nn/kernels/matrix.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <vector>

#include "firmware/base/os.h"
#include "firmware/nn/kernels/words.h"

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "firmware/nn/kernels/matrix.cpp"
#include "firmware/base/simd.h"
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

// Calls f with an object of the operand's type.
template <class F>
HWY_INLINE void with_narrow_operand(Precision precision, F&& f) {
  switch (precision) {
    case Precision::kFloat32:
      return;
    case Precision::kFloat16:
      return f(Float16Operand());
    case Precision::kBfloat16:
      return f(Bfloat16Operand());
    case Precision::kInt8:
      return f(Int8Operand());
  }
}

void rows_of_floats(const RowInput& a, const PackedMatrix& b, const RowOutput& o) {
  if (b.precision == Precision::kFloat32) return multiply_blocks(a, b, o);
  with_narrow_operand(
      b.precision, [&](auto operand) HWY_ATTR { multiply_narrowed<decltype(operand)>(a, b, o); });
}

void rows_of_words(const NarrowInput& a, const PackedMatrix& b, const RowOutput& o) {
  with_narrow_operand(b.precision,
                      [&](auto operand) HWY_ATTR { multiply_words<decltype(operand)>(a, b, o); });
}

RowRange words_of_row(const float* from, int count, Precision precision, float* words) {
  RowRange range;
  with_narrow_operand(precision, [&](auto operand) HWY_ATTR {
    range = decltype(operand)::narrow_rows(from, count, words);
  });
  return range;
}

int lanes() { return static_cast<int>(kLanes); }

bool is_native(Precision precision) {
  switch (precision) {
    case Precision::kFloat32:
      return true;
    case Precision::kFloat16:
      return LCDM_NATIVE_FLOAT16;
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
HWY_EXPORT(rows_of_words);
HWY_EXPORT(words_of_row);
HWY_EXPORT(lanes);
HWY_EXPORT(is_native);

int vector_lanes() { return HWY_DYNAMIC_DISPATCH(lanes)(); }

namespace {

int padded(int columns) { return (columns + vector_lanes() - 1) / vector_lanes() * vector_lanes(); }

bool bfloat16_forgone = false;

// AVX-512 and NEON are older than these instructions of theirs.
bool processor_has(Precision precision) {
#if defined(__x86_64__)
  if (precision != Precision::kBfloat16) return __builtin_cpu_supports("avx512vnni") != 0;
  return !bfloat16_forgone && __builtin_cpu_supports("avx512bf16") != 0;
#else
  return precision == Precision::kInt8 ? os::has_dot_product() : os::has_half_arithmetic();
#endif
}

}  // namespace

void forgo_bfloat16(bool forgone) { bfloat16_forgone = forgone; }

Support support_of(Precision precision) {
  if (precision == Precision::kFloat32) return Support::kNative;
  if (!HWY_DYNAMIC_DISPATCH(is_native)(precision)) return Support::kSlow;
  return processor_has(precision) ? Support::kNative : Support::kNone;
}

Precision native_precision(Precision wanted) {
  // Rows of a word each, which fit wherever rows may.
  return native_precision(wanted, numbers_per_word(Precision::kInt8));
}

Precision native_precision(Precision wanted, int depth, int runs) {
  for (const Precision precision : {Precision::kInt8, Precision::kBfloat16, Precision::kFloat16}) {
    const bool fits = wanted >= precision && rows_fit(depth, precision, runs);
    if (fits && support_of(precision) == Support::kNative) return precision;
  }
  return Precision::kFloat32;
}

namespace {

// Numbers that each column has beside its weights: bias, scale, sums.
int numbers_of_column(Precision precision, int runs) {
  switch (precision) {
    case Precision::kFloat32:
    case Precision::kBfloat16:
      return 1;
    case Precision::kFloat16:
      return 2;
    case Precision::kInt8:
      return 2 + runs;
  }
  return 1;
}

}  // namespace

std::size_t packed_floats(int depth, int columns, Precision precision, int runs) {
  const int words = depth / numbers_per_word(precision) + numbers_of_column(precision, runs);
  return static_cast<std::size_t>(words) * static_cast<std::size_t>(padded(columns));
}

namespace {

using Weight = std::function<float(int, int)>;

float word_of_bits(std::uint32_t bits) { return std::bit_cast<float>(bits); }

// word(k, n) begins at number k of column n.
template <typename Word>
void pack_panels(int depth, int columns, int per_word, std::span<float> out, const Word& word) {
  const int lanes = vector_lanes();
  std::size_t at = 0;
  int width = 0;
  for (int first = 0; first < columns; first += width) {
    width = panel_vectors((padded(columns) - first) / lanes) * lanes;
    for (int k = 0; k < depth; k += per_word) {
      for (int n = first; n < first + width; ++n) out[at++] = n < columns ? word(k, n) : 0.0F;
    }
  }
}

float largest_of_column(int depth, int n, const Weight& weight) {
  float largest = 0;
  for (int k = 0; k < depth; ++k) largest = std::max(largest, std::fabs(weight(k, n)));
  return largest;
}

int rounded(float weight, float scale) {
  return scale > 0 ? static_cast<int>(std::lround(weight / scale)) : 0;
}

std::uint32_t int8_quad(int k, int n, float scale, const Weight& weight) {
  std::uint32_t bits = 0;
  for (int i = 0; i < 4; ++i) {
    const auto byte = static_cast<std::uint8_t>(rounded(weight(k + i, n), scale));
    bits |= static_cast<std::uint32_t>(byte) << (8 * i);
  }
  return bits;
}

// Panels of columns that have one scale each, by their largest weight, and the sums of what remains
// of their weights, run by run.
void pack_int8(const PackedMatrix& m, const Weight& weight, std::span<float> panels,
               std::span<float> scale, std::span<float> sums) {
  const int run_length = m.depth / static_cast<int>(sums.size() / scale.size());
  for (std::size_t n = 0; n < static_cast<std::size_t>(m.columns); ++n) {
    const int column = static_cast<int>(n);
    scale[n] = largest_of_column(m.depth, column, weight) / 127.0F;
    std::size_t at = n;
    for (int run = 0; run < m.depth; run += run_length, at += scale.size()) {
      int sum = 0;
      for (int k = run; k < run + run_length; ++k) sum += rounded(weight(k, column), scale[n]);
      sums[at] = scale[n] * static_cast<float>(sum);
    }
  }
  pack_panels(m.depth, m.columns, 4, panels, [&](int k, int n) {
    return word_of_bits(int8_quad(k, n, scale[static_cast<std::size_t>(n)], weight));
  });
}

void pack_float16(const PackedMatrix& m, const Weight& weight, std::span<float> panels,
                  std::span<float> scale) {
  std::vector<float> inverse(static_cast<std::size_t>(m.columns));
  for (std::size_t n = 0; n < inverse.size(); ++n) {
    const PowerOfTwo power =
        power_of_two_within(largest_of_column(m.depth, static_cast<int>(n), weight));
    scale[n] = power.value;
    inverse[n] = power.inverse;
  }
  pack_panels(m.depth, m.columns, 2, panels, [&](int k, int n) {
    const float factor = inverse[static_cast<std::size_t>(n)];
    return word_of_bits(float16_pair(weight(k, n) * factor, weight(k + 1, n) * factor));
  });
}

}  // namespace

PackedMatrix pack_matrix(int depth, int columns, const Weight& weight, std::span<const float> bias,
                         std::span<float> out, Precision precision, int runs) {
  LCDM_CHECK(out.size() == packed_floats(depth, columns, precision, runs));
  LCDM_CHECK(rows_fit(depth, precision, runs));
  const auto width = static_cast<std::size_t>(padded(columns));
  const std::span<float> of_columns =
      out.last(width * static_cast<std::size_t>(numbers_of_column(precision, runs)));
  const std::span<float> panels = out.first(out.size() - of_columns.size());
  std::fill(of_columns.begin(), of_columns.end(), 0.0F);
  std::copy(bias.begin(), bias.end(), of_columns.begin());
  PackedMatrix matrix = {panels.data(), of_columns.data(), depth, columns, precision};
  switch (precision) {
    case Precision::kFloat32:
      pack_panels(depth, columns, 1, panels, weight);
      break;
    case Precision::kFloat16:
      matrix.scale = matrix.bias + width;
      pack_float16(matrix, weight, panels, of_columns.subspan(width, width));
      break;
    case Precision::kBfloat16:
      pack_panels(depth, columns, 2, panels, [&](int k, int n) {
        return word_of_bits(bfloat16_pair(weight(k, n), weight(k + 1, n)));
      });
      break;
    case Precision::kInt8:
      matrix.scale = matrix.bias + width;
      matrix.sums = matrix.scale + width;
      matrix.sums_pitch = static_cast<std::ptrdiff_t>(width);
      pack_int8(matrix, weight, panels, of_columns.subspan(width, width),
                of_columns.subspan(2 * width));
      break;
  }
  return matrix;
}

void multiply_rows(const RowInput& a, const PackedMatrix& b, const RowOutput& out) {
  LCDM_CHECK(a.runs * a.run_length == b.depth);
  LCDM_CHECK(b.precision == Precision::kFloat32 || (a.runs == 1 && a.stride == b.depth));
  HWY_DYNAMIC_DISPATCH(rows_of_floats)(a, b, out);
}

RowRange narrow_row(const float* from, int count, Precision precision, float* words) {
  return HWY_DYNAMIC_DISPATCH(words_of_row)(from, count, precision, words);
}

void multiply_narrow_rows(const NarrowInput& a, const PackedMatrix& b, const RowOutput& out) {
  LCDM_CHECK(a.words.runs * a.words.run_length * numbers_per_word(b.precision) == b.depth);
  HWY_DYNAMIC_DISPATCH(rows_of_words)(a, b, out);
}

}  // namespace lcdm::kernels
#endif  // HWY_ONCE
