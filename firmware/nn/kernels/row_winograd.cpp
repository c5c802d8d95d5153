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
// product, and the reading takes what the products save.
bool row_winograd_pays(int stride, int channels, int columns, Precision precision) {
  if (precision != Precision::kFloat32 && precision != Precision::kBfloat16) return false;
  if (stride != 1 || channels == 0 || channels > kRowWinogradChannels || channels % 4 != 0) {
    return false;
  }
  return is_by_two(columns) || (columns > vector_lanes() && columns <= kRowWinogradColumns);
}

PackedMatrix pack_row_winograd(int channels, int columns,
                               const std::function<float(int, int, int)>& weight,
                               std::span<const float> bias, std::span<float> out,
                               Precision precision) {
  constexpr double kTransform[kRowProducts][3] = {
      {0.5, 0.5, 0.5}, {0.5, -0.5, 0.5}, {1, 0, 0}, {0, 0, 1}};
  LCDM_CHECK(row_winograd_pays(1, channels, columns, precision));
  const int per_word = numbers_per_word(precision);
  const int pixel = channels / per_word;
  // First both products that both pixels have, of all three kernel rows, then those of one each: of
  // one word, or two, of a pixel at a time, both products' one vector, or two, side by side.
  const bool by_two = is_by_two(columns);
  const int together = by_two ? 2 : 1;
  const auto transformed = [&](int k, int lane) {
    int at = k / per_word;
    const int vector = at % together;
    at /= together;
    const int product = at % 2;
    at /= 2;
    int word = at % (pixel / together) * together;
    at /= pixel / together;
    const double* of_taps = kTransform[at / 3 * 2 + product];
    int column = lane;
    if (by_two) {
      word += lane % 2;
      column = kRowWinogradColumns / 2 * vector + lane / 2;
    }
    double sum = 0;
    for (int tap = 0; tap < 3; ++tap) {
      sum += of_taps[tap] * static_cast<double>(
                                weight(word * per_word + k % per_word, column, 3 * (at % 3) + tap));
    }
    return static_cast<float>(sum);
  };
  return pack_matrix(row_winograd_depth(channels), columns, transformed, bias, out, precision, 3);
}

}  // namespace lcdm::kernels
