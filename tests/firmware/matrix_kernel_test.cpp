// The register tile: products, residual, activation, whatever the shape and the instruction set.
#include <algorithm>
#include <cmath>
#include <gtest/gtest.h>
#include <limits>

#include "firmware/nn/kernels/matrix.h"
#include "firmware/nn/kernels/words.h"
#include "tests/firmware/image.h"

namespace lcdm::kernels {
namespace {

double activated(Activation activation, double x) {
  switch (activation) {
    case Activation::kNone:
      return x;
    case Activation::kSilu:
      return x / (1 + std::exp(-x));
    case Activation::kElu:
      return x > 0 ? x : std::expm1(x);
    case Activation::kRelu:
      return std::max(x, 0.0);
  }
  return x;
}

struct Product {
  int rows;
  int depth;
  int columns;
  Activation activation;
  bool residual;
  Precision precision = Precision::kFloat32;
};

// Largest difference of a sum of `depth` products of numbers within 1: 2^-9 of each bfloat16 factor
// in the worst case, half a step of either 8-bit factor; 2^-11 of each half-precision factor and of
// the sums so far of a block, which stay within 6 where signs vary.
double tolerance_of(const Product& p) {
  switch (p.precision) {
    case Precision::kFloat32:
      return 1e-5 * p.depth;
    case Precision::kFloat16:
      return 1e-5 * p.depth + p.depth * 8.1 / 2048;
    case Precision::kBfloat16:
      return 1e-5 * p.depth + p.depth * 2.1 / 512;
    case Precision::kInt8:
      return 1e-5 * p.depth + p.depth * (1.01 / 255 + 1.01 / 254);
  }
  return 0;
}

void check_product(const Product& p, unsigned seed) {
  SCOPED_TRACE(testing::Message() << p.rows << " x " << p.depth << " x " << p.columns);
  Random random(seed);
  const auto index = [](int row, int column, int width) {
    const int i = row * width + column;
    return static_cast<std::size_t>(i);
  };
  const auto a = random.reals(index(p.rows, 0, p.depth));
  const auto b = random.reals(index(p.depth, 0, p.columns));
  const auto bias = random.reals(static_cast<std::size_t>(p.columns));
  const auto residual = random.reals(index(p.rows, 0, p.columns));
  std::vector<float> packed(packed_floats(p.depth, p.columns, p.precision));
  const PackedMatrix matrix = pack_matrix(
      p.depth, p.columns, [&](int k, int n) { return b[index(k, n, p.columns)]; }, bias, packed,
      p.precision);
  std::vector<float> out(residual.size() + 1, kUntouched);

  RowInput rows = {{a.data()}, 1, p.depth, p.depth, p.rows};
  multiply_rows(rows, matrix,
                {out.data(), p.residual ? residual.data() : nullptr, p.columns, p.activation});

  for (int m = 0; m < p.rows; ++m) {
    for (int n = 0; n < p.columns; ++n) {
      double sum = static_cast<double>(bias[static_cast<std::size_t>(n)]);
      for (int k = 0; k < p.depth; ++k) {
        sum += static_cast<double>(a[index(m, k, p.depth)]) *
               static_cast<double>(b[index(k, n, p.columns)]);
      }
      if (p.residual) sum += static_cast<double>(residual[index(m, n, p.columns)]);
      ASSERT_NEAR(out[index(m, n, p.columns)], activated(p.activation, sum), tolerance_of(p))
          << m << ", " << n;
    }
  }
  EXPECT_EQ(out.back(), kUntouched) << "wrote behind the last row";
}

TEST(MatrixKernel, MultipliesAnyShape) {
  for_each_isa([] {
    unsigned seed = 0;
    for (const int rows : {1, 2, 3, 5, 7, 8, 9, 71}) {
      for (const int depth : {1, 3, 16, 33}) {
        for (const int columns : {1, 4, 8, 15, 16, 17, 33, 48, 49, 100}) {
          check_product({rows, depth, columns, Activation::kNone, seed % 2 == 0}, seed);
          ++seed;
        }
      }
    }
  });
}

TEST(MatrixKernel, AppliesEveryActivation) {
  for_each_isa([] {
    for (const Activation activation :
         {Activation::kNone, Activation::kSilu, Activation::kElu, Activation::kRelu}) {
      check_product({13, 5, 21, activation, false}, 1);
      check_product({13, 5, 21, activation, true}, 2);
    }
  });
}

TEST(MatrixKernel, MultipliesPairsAndQuadsOfNarrowNumbers) {
  for_each_narrow([](Precision precision) {
    unsigned seed = 0;
    for (const int rows : {1, 3, 8, 13, 71, 300}) {
      for (const int depth : {4, 8, 20, 44, 64, 148}) {
        for (const int columns : {1, 8, 15, 17, 33, 48, 100}) {
          check_product({rows, depth, columns, Activation::kSilu, seed % 2 == 0, precision}, seed);
          ++seed;
        }
      }
    }
  });
}

// Beside narrow products activations are rough: x itself, a number that bfloat16 holds, activated.
// One column goes through vectors of its own size, a vector of columns through whole ones.
void check_rough_activations(int columns) {
  SCOPED_TRACE(testing::Message() << columns << " columns");
  std::vector<float> rows;
  for (int i = -128; i <= 128; ++i) {
    const auto x = static_cast<float>(i);
    for (const float value : {x / 8, x * 8}) rows.insert(rows.end(), {value, 0});
  }
  const std::size_t count = rows.size() / 2;
  std::vector<float> packed(packed_floats(2, columns, Precision::kBfloat16));
  const PackedMatrix ones = pack_matrix(
      2, columns, [](int, int) { return 1.0F; }, {}, packed, Precision::kBfloat16);
  for (const Activation activation : {Activation::kSilu, Activation::kElu}) {
    std::vector<float> out(count * static_cast<std::size_t>(columns));
    multiply_rows({{rows.data()}, 1, 2, 2, static_cast<int>(count)}, ones,
                  {out.data(), nullptr, columns, activation});
    for (std::size_t i = 0; i < out.size(); ++i) {
      const double x = rows[2 * (i / static_cast<std::size_t>(columns))];
      const double want = activated(activation, x);
      const bool by_table = activation == Activation::kSilu && columns == 16;  // AVX-512's vector
      const double rough = by_table ? 4e-4 : 1e-4;
      ASSERT_NEAR(out[i], want, rough + 5e-4 * std::fabs(want)) << "of " << x;
    }
  }
}

TEST(MatrixKernel, ActivatesWithinTheLastBitsOfHalves) {
  for_each_isa([] {
    if (support_of(Precision::kBfloat16) == Support::kNone) return;
    check_rough_activations(1);
    check_rough_activations(vector_lanes());
  });
}

// What Armv8.2's conversion gives, which the ends of rows meet too.
TEST(HalfWord, RoundsToNearestAndKeepsWhatIsInfiniteAndWhatIsNoNumber) {
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  const struct {
    float number;
    std::uint32_t bits;
  } cases[] = {{1, 0x3C00},        {1 + 0x1p-11F, 0x3C00}, {1 + 0x1.8p-10F, 0x3C02},
               {65519, 0x7BFF},    {65520, 0x7C00},        {65536, 0x7C00},
               {1e38F, 0x7C00},    {kInfinity, 0x7C00},    {-kInfinity, 0xFC00},
               {0x1p-24F, 0x0001}, {0x1p-25F, 0x0000},     {-0x1.8p-24F, 0x8002}};
  for (const auto& [number, bits] : cases) EXPECT_EQ(float16_bits(number), bits) << number;
  EXPECT_EQ(float16_bits(std::numeric_limits<float>::quiet_NaN()), 0x7E00U);
}

// So that a sum that overflowed shows as no depth, not as some: wherever in a row it is, in whole
// vectors and at their ends.
TEST(MatrixKernel, NoNumberStaysNone) {
  constexpr int kDepth = 76;
  for_each_isa([] {
    for (const Precision precision :
         {Precision::kFloat32, Precision::kFloat16, Precision::kBfloat16, Precision::kInt8}) {
      // The stand-in for halves has no such numbers.
      const bool halves = precision == Precision::kFloat16;
      if (support_of(precision) < (halves ? Support::kNative : Support::kSlow)) continue;
      const int columns = vector_lanes();
      std::vector<float> packed(packed_floats(kDepth, columns, precision));
      const PackedMatrix ones = pack_matrix(
          kDepth, columns, [](int, int) { return 1.0F; }, {}, packed, precision);
      for (const Activation activation :
           {Activation::kNone, Activation::kSilu, Activation::kElu, Activation::kRelu}) {
        for (int place = 0; place < kDepth; ++place) {
          std::vector<float> row(kDepth);
          row[static_cast<std::size_t>(place)] = std::numeric_limits<float>::quiet_NaN();
          std::vector<float> out(static_cast<std::size_t>(columns));
          multiply_rows({{row.data()}, 1, kDepth, kDepth, 1}, ones,
                        {out.data(), nullptr, columns, activation});
          for (const float value : out) {
            ASSERT_TRUE(std::isnan(value))
                << to_string(precision) << static_cast<int>(activation) << " at " << place;
          }
        }
      }
    }
  });
}

// Whole numbers, from 0 in rows and of either sign in weights, whose products sum up exactly. Bytes
// begin and end with their range. Halves add some products in half precision, up to 2048.
struct Whole {
  int row;
  int weight;
};
Whole exact_in(Precision precision) {
  return precision == Precision::kFloat16 ? Whole{15, 7} : Whole{255, 127};
}

TEST(MatrixKernel, NarrowNumbersThatAreExactGiveExactSums) {
  for_each_narrow([](Precision precision) {
    constexpr int kDepth = 256;
    const Whole whole = exact_in(precision);
    std::vector<float> a(kDepth);
    double expected = 3;
    const auto weight = [&](int k, int) {
      return static_cast<float>((k * 37) % (2 * whole.weight + 1) - whole.weight);
    };
    for (int k = 0; k < kDepth; ++k) {
      a[static_cast<std::size_t>(k)] = static_cast<float>((k * 91) % (whole.row + 1));
      expected +=
          static_cast<double>(a[static_cast<std::size_t>(k)]) * static_cast<double>(weight(k, 0));
    }
    const float bias = 3;
    std::vector<float> packed(packed_floats(kDepth, 1, precision));
    const PackedMatrix matrix = pack_matrix(kDepth, 1, weight, {&bias, 1}, packed, precision);
    float out = 0;
    multiply_rows({{a.data()}, 1, kDepth, kDepth, 1}, matrix,
                  {&out, nullptr, 1, Activation::kNone});
    EXPECT_EQ(out, static_cast<float>(expected)) << to_string(precision);
  });
}

// Rows and columns whose numbers are small whole ones times powers of two, other powers for each
// range of rows and each column: nothing is rounded, unless rows are taken with others' range.
struct ExactProduct {
  static constexpr int kRows = 20;  // two whole ranges and a half
  static constexpr int kColumns = 20;
  int depth;
  std::vector<float> a, weights, expected;

  ExactProduct(Random& random, int of_depth, Whole whole) : depth(of_depth) {
    for (int m = 0; m < kRows; ++m) {
      const int range = m / kRowsOfRange;
      for (int k = 0; k < depth; ++k) {
        // Each row has both ends of its range.
        const int number = k == 0 ? 0 : (k == 1 ? whole.row : random.whole(0, whole.row));
        a.push_back(
            std::ldexp(static_cast<float>(number - whole.row / 2 * range), 10 * range - 10));
      }
    }
    for (int k = 0; k < depth; ++k) {
      for (int n = 0; n < kColumns; ++n) {
        const int number = k == 2 ? whole.weight : random.whole(-whole.weight, whole.weight);
        weights.push_back(std::ldexp(static_cast<float>(number), n % 7 - 3));
      }
    }
    for (int m = 0; m < kRows; ++m) {
      for (int n = 0; n < kColumns; ++n) {
        double sum = 0;
        for (int k = 0; k < depth; ++k) {
          sum += static_cast<double>(a[static_cast<std::size_t>(m * depth + k)]) *
                 static_cast<double>(weights[static_cast<std::size_t>(k * kColumns + n)]);
        }
        expected.push_back(static_cast<float>(sum));
      }
    }
  }
};

void check_exact(const ExactProduct& p, Precision precision) {
  SCOPED_TRACE(testing::Message() << to_string(precision) << ", depth " << p.depth);
  constexpr int kColumns = ExactProduct::kColumns;
  std::vector<float> packed(packed_floats(p.depth, kColumns, precision));
  const PackedMatrix matrix = pack_matrix(
      p.depth, kColumns,
      [&](int k, int n) { return p.weights[static_cast<std::size_t>(k * kColumns + n)]; }, {},
      packed, precision);
  std::vector<float> out(p.expected.size());
  const auto multiply = [&](int begin, int end) {
    const float* rows = p.a.data() + static_cast<std::ptrdiff_t>(begin) * p.depth;
    float* to = out.data() + static_cast<std::ptrdiff_t>(begin) * kColumns;
    multiply_rows({{rows}, 1, p.depth, p.depth, end - begin}, matrix,
                  {to, nullptr, kColumns, Activation::kNone});
  };
  // All at once, and in two slices as two workers would.
  for (const int cut : {0, kRowsOfRange, 2 * kRowsOfRange}) {
    std::fill(out.begin(), out.end(), 0.0F);
    multiply(cut, ExactProduct::kRows);
    multiply(0, cut);
    EXPECT_EQ(out, p.expected) << "cut at " << cut;
  }
}

TEST(MatrixKernel, EachRangeOfRowsIsItsOwnHoweverFarApartTheyAre) {
  for_each_narrow([](Precision precision) {
    Random random(8);
    // The last is the deepest that fits: one range is all that is held narrow at a time.
    for (const int depth : {20, 64, kNarrowWords / kRowsOfRange * numbers_per_word(precision)}) {
      check_exact({random, depth, exact_in(precision)}, precision);
    }
  });
}

// A half ends at 65504 and begins at 6e-8: neither may show, in rows, columns or sums.
TEST(MatrixKernel, HalvesNeitherOverflowNorVanish) {
  for_each_isa([] {
    if (support_of(Precision::kFloat16) == Support::kNone) return;
    constexpr int kDepth = 64;
    for (const float size : {1e-30F, 1e-10F, 1.0F, 1e10F, 1e30F, 1.1e38F}) {
      const std::vector<float> a(kDepth, 3 * size);
      std::vector<float> packed(packed_floats(kDepth, 1, Precision::kFloat16));
      const PackedMatrix matrix = pack_matrix(
          kDepth, 1, [size](int, int) { return -5 / size; }, {}, packed, Precision::kFloat16);
      float out = 0;
      multiply_rows({{a.data()}, 1, kDepth, kDepth, 1}, matrix,
                    {&out, nullptr, 1, Activation::kNone});
      EXPECT_NEAR(out, -15.0F * kDepth, 1) << size;
    }
  });
}

TEST(MatrixKernel, RowsTooLongToBeNarrowStayWide) {
  static_assert(rows_fit(2048, Precision::kInt8) && !rows_fit(2052, Precision::kInt8));
  static_assert(rows_fit(1024, Precision::kBfloat16) && !rows_fit(1026, Precision::kBfloat16));
  static_assert(!rows_fit(6, Precision::kInt8) && rows_fit(1'000'000, Precision::kFloat32));
  for_each_isa([] {
    for (const Precision wanted : kPrecisions) {
      for (const int depth : {7, 18, 20, 1026, 2048, 2052}) {
        const Precision given = native_precision(wanted, depth);
        EXPECT_TRUE(given <= native_precision(wanted) && rows_fit(depth, given)) << depth;
      }
    }
  });
  std::vector<float> store(packed_floats(2052, 1, Precision::kInt8));
  const auto pack = [&] {
    pack_matrix(
        2052, 1, [](int, int) { return 1.0F; }, {}, store, Precision::kInt8);
  };
  EXPECT_DEATH(pack(), "rows_fit");
}

TEST(MatrixKernel, ConstantRowsAndZeroWeightsHaveNoRangeAndStayRight) {
  for_each_isa([] {
    if (support_of(Precision::kInt8) == Support::kNone) return;
    const std::vector<float> a(8, -2.5F);
    for (const float w : {0.0F, 0.75F}) {
      std::vector<float> packed(packed_floats(8, 1, Precision::kInt8));
      const PackedMatrix matrix = pack_matrix(
          8, 1, [w](int, int) { return w; }, {}, packed, Precision::kInt8);
      float out = 1;
      multiply_rows({{a.data()}, 1, 8, 8, 1}, matrix, {&out, nullptr, 1, Activation::kNone});
      EXPECT_NEAR(out, 8 * -2.5F * w, 1e-5F);
    }
  });
}

// One value through a 1x1 product with weights of 1, as its last column has it.
float through(Activation activation, float x, int columns) {
  std::vector<float> packed(packed_floats(1, columns));
  const PackedMatrix ones = pack_matrix(
      1, columns, [](int, int) { return 1.0F; }, {}, packed);
  std::vector<float> out(static_cast<std::size_t>(columns));
  multiply_rows({{&x}, 1, 1, 1, 1}, ones, {out.data(), nullptr, columns, activation});
  return out.back();
}

// AVX-512's whole vectors have another e^x than narrower ones, of a rounded exponent.
void check_activations(int columns) {
  SCOPED_TRACE(testing::Message() << columns << " columns");
  const double of_exponent = columns == 16 ? 7e-8 : 0;
  for (int i = -2200; i < 2200; ++i) {
    const float x = 0.0363F * static_cast<float>(i);
    const double rough = 1e-6 + of_exponent * std::fabs(static_cast<double>(x));
    const double silu = activated(Activation::kSilu, static_cast<double>(x));
    ASSERT_NEAR(through(Activation::kSilu, x, columns), silu, rough * std::fabs(silu)) << x;
    const double elu = activated(Activation::kElu, static_cast<double>(x));
    ASSERT_NEAR(through(Activation::kElu, x, columns), elu, 2e-7 + 1e-7 * std::fabs(elu)) << x;
  }
  // Far outside they stay finite and right.
  EXPECT_NEAR(through(Activation::kSilu, -1e4F, columns), 0, 1e-30);
  EXPECT_EQ(through(Activation::kSilu, 1e4F, columns), 1e4F);
  EXPECT_EQ(through(Activation::kElu, -1e30F, columns), -1.0F);
  for (const Activation activation : {Activation::kSilu, Activation::kElu}) {
    EXPECT_TRUE(std::isnan(through(activation, std::numeric_limits<float>::quiet_NaN(), columns)));
  }
}

TEST(MatrixKernel, ActivationsAreAccurateOverTheirWholeRange) {
  for_each_isa([] {
    check_activations(1);
    check_activations(vector_lanes());
  });
}

}  // namespace
}  // namespace lcdm::kernels
