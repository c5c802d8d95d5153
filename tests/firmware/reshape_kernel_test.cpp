// Patches and resizing on figures worked by hand.
#include <gtest/gtest.h>
#include <vector>

#include "firmware/nn/kernels/reshape.h"

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

}  // namespace
}  // namespace lcdm::kernels
