// Products stored two rows to a word, for what reads them so (RowOutput::paired).
#include <bit>
#include <cmath>
#include <cstdint>
#include <gtest/gtest.h>
#include <vector>

#include "firmware/nn/kernels/matrix.h"
#include "firmware/nn/kernels/words.h"
#include "tests/firmware/image.h"

namespace lcdm::kernels {
namespace {

struct PairsCase {
  Precision precision;
  Activation activation;
  int rows;
  int columns;
};

// The same rows as floats and as pairs: those hold these rounded, and nothing else is written.
void check_pairs(Random& random, const PairsCase& c) {
  SCOPED_TRACE(testing::Message() << to_string(c.precision) << ", " << c.rows << " rows, "
                                  << c.columns << " columns");
  constexpr int kDepth = 8;
  constexpr int kGap = 5;  // words between pairs
  const auto rows = random.reals(static_cast<std::size_t>(c.rows * kDepth));
  const auto weights = random.reals(static_cast<std::size_t>(kDepth * c.columns));
  std::vector<float> store(packed_floats(kDepth, c.columns, c.precision));
  const PackedMatrix matrix = pack_matrix(
      kDepth, c.columns,
      [&](int k, int n) { return weights[static_cast<std::size_t>(k * c.columns + n)]; }, {}, store,
      c.precision);
  const RowInput input = {{rows.data()}, 1, kDepth, kDepth, c.rows};
  std::vector<float> plain(static_cast<std::size_t>(c.rows * c.columns));
  multiply_rows(input, matrix, {plain.data(), nullptr, c.columns, c.activation});
  const int pitch = c.columns + kGap;
  std::vector<float> words(static_cast<std::size_t>((c.rows + 1) / 2 * pitch), kUntouched);
  multiply_rows(input, matrix, {words.data(), nullptr, pitch, c.activation, true});

  for (int at = 0; at < static_cast<int>(words.size()); ++at) {
    const float word = words[static_cast<std::size_t>(at)];
    if (at % pitch >= c.columns) {
      ASSERT_EQ(word, kUntouched) << "beyond the last column";
      continue;
    }
    const auto bits = std::bit_cast<std::uint32_t>(word);
    for (int half = 0; half < 2; ++half) {
      const int row = at / pitch * 2 + half;
      const float number = half == 0 ? bfloat16_first(bits) : bfloat16_second(bits);
      const auto plain_at = static_cast<std::size_t>(row * c.columns + at % pitch);
      const float want = row < c.rows ? plain[plain_at] : 0.0F;
      ASSERT_NEAR(number, want, std::fabs(want) / 256) << "row " << row;
    }
  }
}

TEST(PairsKernel, HoldTheRowsAndNothingBesideThem) {
  for_each_narrow([](Precision precision) {
    Random random(3);
    for (const int columns : {1, 4, 8, 15, 16, 17, 20, 33, 48, 100}) {
      for (const int rows : {1, 2, 3, 7, 8, 13, 71, 131}) {
        check_pairs(random, {precision, Activation::kSilu, rows, columns});
        if (precision != Precision::kBfloat16 || columns > vector_lanes()) continue;
        check_pairs(random, {precision, Activation::kNone, rows, columns});
      }
    }
  });
}

}  // namespace
}  // namespace lcdm::kernels
