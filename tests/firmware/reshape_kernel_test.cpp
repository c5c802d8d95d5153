// Patches and resizing on figures worked by hand, and at random against plain loops.
#include <algorithm>
#include <gtest/gtest.h>
#include <vector>

#include "firmware/nn/kernels/reshape.h"
#include "tests/firmware/image.h"

namespace lcdm::kernels {
namespace {

TEST(ReshapeKernel, UnfoldGroupsPixelsByTheirPlaceInThePatchAndFoldUndoesIt) {
  // Pixel values are 10 y + x; patches of 2x2 in a 4x6 image.
  std::vector<float> image;
  for (int y = 0; y < 4; ++y) {
    for (int x = 0; x < 6; ++x) image.push_back(static_cast<float>(10 * y + x));
  }
  std::vector<float> tokens(image.size());
  const Patches patches = {4, 6, 1};
  unfold_rows(patches, image.data(), tokens.data(), 0, 2);
  EXPECT_EQ(tokens, (std::vector<float>{0,  2,  4,  20, 22, 24,  // top left of each patch
                                        1,  3,  5,  21, 23, 25,  // top right
                                        10, 12, 14, 30, 32, 34,  // bottom left
                                        11, 13, 15, 31, 33, 35}));
  std::vector<float> back(image.size());
  fold_rows(patches, tokens.data(), back.data(), 0, 1);
  fold_rows(patches, tokens.data(), back.data(), 1, 2);
  EXPECT_EQ(back, image);
}

TEST(ReshapeKernel, ResizeInterpolatesBetweenPixelCentres) {
  // 3 to 4 columns: centres at -.125 (clamped), .625, 1.375, 2.125 (clamped).
  const std::vector<float> row = {0, 8, 16};
  std::vector<float> out(4);
  resize_rows({row.data(), 1, 3, 1, 4, 1, out.data()}, 0, 1);
  EXPECT_EQ(out, (std::vector<float>{0, 5, 11, 16}));
  // Down and up again keeps a constant image constant.
  const std::vector<float> flat(15 * 5 * 3, 2.5F);
  std::vector<float> up(16 * 6 * 3);
  resize_rows({flat.data(), 15, 5, 16, 6, 3, up.data()}, 0, 16);
  for (const float v : up) ASSERT_EQ(v, 2.5F);
}

TEST(ReshapeKernel, AnyImageUnfoldsToItsPatchesAndBack) {
  Random random(1);
  for (int round = 0; round < 20; ++round) {
    const Image image =
        make_image(random, 2 * random.whole(1, 6), 2 * random.whole(1, 6), random.whole(1, 40));
    const auto values = to_floats(image.values);
    const Patches patches = {image.height, image.width, image.channels};
    std::vector<float> tokens(values.size());
    const int rows = image.height / 2;
    const int cut = random.whole(0, rows);
    unfold_rows(patches, values.data(), tokens.data(), cut, rows);
    unfold_rows(patches, values.data(), tokens.data(), 0, cut);
    std::size_t i = 0;  // [place in the patch, patch, channel]
    for (int place = 0; place < 4; ++place) {
      for (int y = place / 2; y < image.height; y += 2) {
        for (int x = place % 2; x < image.width; x += 2) {
          for (int c = 0; c < image.channels; ++c) {
            ASSERT_EQ(tokens[i++], static_cast<float>(image.at(y, x, c)));
          }
        }
      }
    }
    std::vector<float> back(values.size());
    fold_rows(patches, tokens.data(), back.data(), 0, cut);
    fold_rows(patches, tokens.data(), back.data(), cut, rows);
    ASSERT_EQ(back, values);
  }
}

// Of the four pixels around (y, x).
double interpolated(const Image& image, double y, double x, int c) {
  const double row = std::clamp(y, 0.0, image.height - 1.0);
  const double column = std::clamp(x, 0.0, image.width - 1.0);
  const int y0 = static_cast<int>(row);
  const int x0 = static_cast<int>(column);
  const int y1 = std::min(y0 + 1, image.height - 1);
  const int x1 = std::min(x0 + 1, image.width - 1);
  const auto blend = [&](int at) {
    return image.at(at, x0, c) + (column - x0) * (image.at(at, x1, c) - image.at(at, x0, c));
  };
  return blend(y0) + (row - y0) * (blend(y1) - blend(y0));
}

TEST(ReshapeKernel, ResizesAnyImageAsPlainInterpolationDoes) {
  Random random(2);
  for (int round = 0; round < 20; ++round) {
    const Image in =
        make_image(random, random.whole(1, 9), random.whole(1, 9), random.whole(1, 40));
    Image want = {random.whole(1, 12), random.whole(1, 12), in.channels, {}};
    for (int y = 0; y < want.height; ++y) {
      for (int x = 0; x < want.width; ++x) {
        const double from_y = (y + 0.5) * in.height / want.height - 0.5;
        const double from_x = (x + 0.5) * in.width / want.width - 0.5;
        for (int c = 0; c < in.channels; ++c) {
          want.values.push_back(interpolated(in, from_y, from_x, c));
        }
      }
    }
    const auto values = to_floats(in.values);
    std::vector<float> out(want.values.size());
    const Resize args = {values.data(), in.height,   in.width,  want.height,
                         want.width,    in.channels, out.data()};
    const int cut = random.whole(0, want.height);
    resize_rows(args, cut, want.height);
    resize_rows(args, 0, cut);
    expect_near(out, want, 1e-5);
  }
}

}  // namespace
}  // namespace lcdm::kernels
