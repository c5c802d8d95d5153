// Channels-last images of doubles, for references one can check by eye.
#pragma once

#include <gtest/gtest.h>
#include <vector>

#include "firmware/nn/network.h"
#include "tests/firmware/isa.h"

namespace lcdm::test {

struct Image {
  int height = 0;
  int width = 0;
  int channels = 0;
  std::vector<double> values;

  double at(int y, int x, int c) const {
    return values[static_cast<std::size_t>((y * width + x) * channels + c)];
  }
  double padded(int y, int x, int c, Padding padding) const {
    if (padding == Padding::kReflect) return at(mirror(y, height), mirror(x, width), c);
    return y >= 0 && y < height && x >= 0 && x < width ? at(y, x, c) : 0;
  }
  static int mirror(int i, int size) { return i < 0 ? -i : (i >= size ? 2 * size - 2 - i : i); }
};

inline Image make_image(Random& random, int height, int width, int channels) {
  Image image{height, width, channels, {}};
  for (int i = 0; i < height * width * channels; ++i) {
    image.values.push_back(static_cast<double>(random.real()));
  }
  return image;
}

inline std::vector<float> to_floats(const std::vector<double>& values) {
  return {values.begin(), values.end()};
}
inline void expect_near(const std::vector<float>& got, const Image& want, double tolerance) {
  ASSERT_EQ(got.size(), want.values.size());
  for (std::size_t i = 0; i < got.size(); ++i) ASSERT_NEAR(got[i], want.values[i], tolerance) << i;
}

}  // namespace lcdm::test
