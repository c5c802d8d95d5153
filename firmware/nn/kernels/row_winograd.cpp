#include "firmware/nn/kernels/row_winograd.h"

#include "firmware/base/check.h"

namespace lcdm::kernels {

namespace {

// Whether all columns are one vector, and two words of a pixel are taken at a time (kByTwo).
bool is_by_two(int columns) {
  return vector_lanes() == kRowWinogradColumns && columns == kRowWinogradColumns;
}

}  // namespace

// To more columns F(4x4, 3x3) or bytes are faster; to fewer each word that is read serves one
// product, and the reading takes what the products save. So it does with AVX2, whose 16 registers
// hold few sums for each weight.
bool row_winograd_pays(int stride, int channels, int columns, Precision precision) {
  if (precision != Precision::kFloat32 && precision != Precision::kBfloat16) return false;
  if (stride != 1 || channels == 0 || channels > kRowWinogradChannels || channels % 4 != 0) {
    return false;
  }
  const int lanes = vector_lanes();
  if (lanes == kRowWinogradNotLanes) return false;
  return is_by_two(columns) || (columns > lanes && columns <= kRowWinogradColumns);
}

namespace {

// Where a weight of the matrix comes from.
struct Place {
  int product;
  int row;   // of the kernel
  int word;  // of the pixel
  int column;
};

// Of word `at` of a lane. First come both products that both pixels share, of all kernel rows, then
// the two of one pixel each: of one word at a time a vector of either product, or of two words two
// vectors of either, with half the columns each.
Place place_of(int at, int lane, int pixel, bool by_two) {
  const int together = by_two ? 2 : 1;
  const int vector = at % together;
  const int product = at / together % 2;
  at /= 2 * together;
  const int steps = pixel / together;
  Place place = {at / steps / 3 * 2 + product, at / steps % 3, at % steps * together, lane};
  if (by_two) {
    place.word += lane % 2;
    place.column = kRowWinogradColumns / 2 * vector + lane / 2;
  }
  return place;
}

}  // namespace

PackedMatrix pack_row_winograd(int channels, int columns,
                               const std::function<float(int, int, int)>& weight,
                               std::span<const float> bias, std::span<float> out,
                               Precision precision) {
  LCDM_CHECK(row_winograd_pays(1, channels, columns, precision));
  constexpr double kTransform[kRowProducts][3] = {
      {0.5, 0.5, 0.5}, {0.5, -0.5, 0.5}, {1, 0, 0}, {0, 0, 1}};
  const int per_word = numbers_per_word(precision);
  const auto transformed = [&](int k, int lane) {
    const Place p = place_of(k / per_word, lane, channels / per_word, is_by_two(columns));
    const int channel = p.word * per_word + k % per_word;
    double sum = 0;
    for (int tap = 0; tap < 3; ++tap) {
      const auto w = static_cast<double>(weight(channel, p.column, 3 * p.row + tap));
      sum += kTransform[p.product][tap] * w;
    }
    return static_cast<float>(sum);
  };
  return pack_matrix(row_winograd_depth(channels), columns, transformed, bias, out, precision, 3);
}

}  // namespace lcdm::kernels
