// Medleys: things of every kind anywhere, seen from anywhere, and the photographs they are painted
// with.
#include <algorithm>
#include <cmath>
#include <gtest/gtest.h>
#include <numeric>

#include "drivers/scene/places.h"
#include "drivers/scene/render.h"
#include "drivers/scene/textures.h"
#include "tests/drivers/scene_picture.h"

namespace lcdm::scene {
namespace {

std::unique_ptr<Picture> medley(std::uint64_t seed, int photographs = 0) {
  auto picture = blank(96, 72, 65);
  fill_medley(seed, photographs, picture->snapshot);
  render(picture->snapshot, picture->camera, picture->rgb, picture->depth);
  return picture;
}

TEST(SceneMedleys, AreThoseOfTheirSeed) {
  for (const std::uint64_t seed : {3U, 4U, 5U}) EXPECT_EQ(medley(seed)->rgb, medley(seed)->rgb);
  EXPECT_NE(medley(3)->rgb, medley(4)->rgb);
}

TEST(SceneMedleys, AreIndoorsAndOutFromAnyHeightUnderAnyAngle) {
  int indoors = 0;
  int low = 0;
  int high = 0;
  int rolled = 0;
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    Snapshot snapshot;
    fill_medley(seed, 0, snapshot);
    indoors += snapshot.indoor ? 1 : 0;
    low += -snapshot.eye.y < 0.5F ? 1 : 0;
    high += -snapshot.eye.y > 2 ? 1 : 0;
    rolled += std::abs(snapshot.axes[0].y) > 0.05F ? 1 : 0;
    EXPECT_LT(snapshot.count, Snapshot::kMaxPrimitives) << "seed " << seed;
  }
  for (const int count : {indoors, low, high, rolled}) EXPECT_GE(count, 10);
  EXPECT_LE(indoors, 80);
}

// The same things at the same places, darker where the photograph is.
TEST(SceneMedleys, ArePaintedWithPhotographsWhereThereAreSome) {
  Photograph photograph;
  int darker = 0;
  int painted = 0;
  int all = 0;
  for (std::uint64_t seed = 0; seed < 12; ++seed) {
    photograph.grey.fill(0);
    use_photographs({&photograph, 1});
    const auto dark = medley(seed, 1);
    photograph.grey.fill(255);
    use_photographs({&photograph, 1});
    const auto light = medley(seed, 1);
    EXPECT_EQ(dark->depth, light->depth) << seed;
    const auto sum = [](const Picture& p) {
      return std::accumulate(p.rgb.begin(), p.rgb.end(), 0);
    };
    EXPECT_LE(sum(*dark), sum(*light)) << seed;
    darker += sum(*dark) < sum(*light) ? 1 : 0;
    for (const Primitive& p : dark->snapshot.primitives()) {
      painted += p.texture == lcdm::scene::photograph(0) ? 1 : 0;
      ++all;
    }
  }
  use_photographs({});
  EXPECT_GE(darker, 8);
  EXPECT_GT(painted, all / 20);  // chairs, cars and the like have colours of their own
  EXPECT_LT(painted, all / 2);
}

TEST(SceneTextures, MirrorPhotographsSoThatTheyRepeatWithoutASeam) {
  Photograph photograph;
  for (std::size_t i = 0; i < photograph.grey.size(); ++i) {
    photograph.grey[i] = static_cast<std::uint8_t>(i * 7);
  }
  use_photographs({&photograph, 1});
  const TextureSet::Texel* tile = textures().tile(lcdm::scene::photograph(0));
  constexpr int kSide = TextureSet::kSide;
  for (const int at : {0, 5, Photograph::kSide - 1}) {
    EXPECT_EQ(tile[at] & 0xFF, photograph.grey[static_cast<std::size_t>(at)]);
    EXPECT_EQ(tile[at], tile[kSide - 1 - at]);
    EXPECT_EQ(tile[at * kSide], tile[(kSide - 1 - at) * kSide]);
  }
  use_photographs({});
}

TEST(SceneMedleys, HaveTheCameraInTheOpen) {
  int blind = 0;
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    const auto picture = medley(seed);
    std::vector<float> depth = picture->depth;
    std::sort(depth.begin(), depth.end());
    if (depth[depth.size() / 2] > 0 && depth[depth.size() / 2] < 0.25F) ++blind;
  }
  EXPECT_LE(blind, 5) << "crowded rooms may leave no free place";
}

}  // namespace
}  // namespace lcdm::scene
