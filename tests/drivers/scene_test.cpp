// The rendered scene: its depth against rays solved in double precision, its poses against its own
// pictures, its promises about seeds, time, threads and memory.
#include "drivers/scene/scene.h"

#include <algorithm>
#include <cmath>
#include <gtest/gtest.h>
#include <memory>
#include <optional>
#include <thread>
#include <vector>

#include "drivers/scene/render.h"
#include "drivers/scene/textures.h"
#include "firmware/base/alloc_watch.h"
#include "tests/drivers/scene_picture.h"
#include "tests/firmware/isa.h"

namespace lcdm::scene {
namespace {

std::unique_ptr<Picture> take(std::uint64_t seed, double seconds, int width = 160,
                              int height = 120) {
  auto picture = blank(width, height, 65);
  Scene(seed).at(seconds, picture->snapshot);
  render(picture->snapshot, picture->camera, picture->rgb, picture->depth);
  return picture;
}

// ---- rays in double precision, by other formulas than the renderer's
// ------------------------------

struct Ray {
  double o[3];
  double d[3];
};

Ray ray_through(const Picture& picture, double x, double y) {
  const CameraModel& c = picture.camera;
  const double right = (x - c.cx) / c.fx;
  const double down = (y - c.cy) / c.fy;
  const auto& a = picture.snapshot.axes;
  const Vec3 e = picture.snapshot.eye;
  return {{e.x, e.y, e.z},
          {a[0].x * right + a[1].x * down + a[2].x, a[0].y * right + a[1].y * down + a[2].y,
           a[0].z * right + a[1].z * down + a[2].z}};
}

// Signed distance from a point to a primitive's surface.
double distance_to(const Primitive& p, const double (&at)[3]) {
  const double v[3] = {at[0] - p.centre.x, at[1] - p.centre.y, at[2] - p.centre.z};
  const double lx = p.cos_yaw * v[0] - p.sin_yaw * v[2];
  const double lz = p.sin_yaw * v[0] + p.cos_yaw * v[2];
  switch (p.shape) {
    case Shape::kSphere:
      return std::hypot(v[0], v[1], v[2]) - p.radius;
    case Shape::kCapsule: {
      const double aa = static_cast<double>(p.half.x) * p.half.x +
                        static_cast<double>(p.half.y) * p.half.y +
                        static_cast<double>(p.half.z) * p.half.z;
      const double along =
          std::clamp((v[0] * p.half.x + v[1] * p.half.y + v[2] * p.half.z) / aa, -1.0, 1.0);
      return std::hypot(v[0] - along * p.half.x, v[1] - along * p.half.y, v[2] - along * p.half.z) -
             p.radius;
    }
    case Shape::kHoop:
      return std::hypot(std::hypot(lx, v[1]) - p.half.x, lz) - p.radius;
    case Shape::kBox: {
      const double q[3] = {std::abs(lx) - p.half.x, std::abs(v[1]) - p.half.y,
                           std::abs(lz) - p.half.z};
      return std::hypot(std::max(q[0], 0.0), std::max(q[1], 0.0), std::max(q[2], 0.0)) +
             std::min(std::max({q[0], q[1], q[2]}), 0.0);
    }
  }
  return 0;
}

// Walks the ray by the distance to the nearest surface: another method than solving equations, and
// the same for all shapes. Empty for the sky.
std::optional<double> walk(const Snapshot& snapshot, const Ray& ray) {
  const double norm = std::hypot(ray.d[0], ray.d[1], ray.d[2]);
  double t = 0;
  for (int i = 0; i < 4000 && t < 390; ++i) {
    const double at[3] = {ray.o[0] + t * ray.d[0], ray.o[1] + t * ray.d[1],
                          ray.o[2] + t * ray.d[2]};
    double nearest = -at[1];  // the ground
    for (const Primitive& p : snapshot.primitives()) {
      nearest = std::min(nearest, distance_to(p, at));
    }
    if (nearest < 1e-7) return t;
    t += nearest / norm;
  }
  return std::nullopt;
}

class EveryKind : public ::testing::TestWithParam<int> {};

TEST_P(EveryKind, DepthIsThatOfRaysWalkedInDoublePrecision) {
  const auto picture = take(static_cast<std::uint64_t>(GetParam()), 4.3);
  int compared = 0;
  int wrong = 0;
  for (int y = 1; y < picture->camera.height; y += 3) {
    for (int x = 1; x < picture->camera.width; x += 5) {
      const auto expected = walk(picture->snapshot, ray_through(*picture, x, y));
      const double ours = picture->depth_at(x, y);
      ++compared;
      const double limit = 1e-3 + 1e-4 * expected.value_or(0);
      if (std::abs(ours - expected.value_or(0)) > limit) ++wrong;
    }
  }
  EXPECT_EQ(compared, 40 * 32);
  // A ray along a silhouette may end on either side of it.
  EXPECT_LE(wrong, compared / 200);
}

TEST_P(EveryKind, APixelMovedByPoseAndDepthLandsOnItself) {
  const auto seed = static_cast<std::uint64_t>(GetParam());
  const auto first = take(seed, 2.0, 320, 240);
  const auto second = take(seed, 2.1, 320, 240);
  const Snapshot& a = first->snapshot;
  const Snapshot& b = second->snapshot;
  int seen = 0;
  int same_depth = 0;
  double colour_error = 0;
  for (int y = 2; y < 238; ++y) {
    for (int x = 2; x < 318; ++x) {
      const double z = first->depth_at(x, y);
      if (z <= 0 || z > 40) continue;
      const Ray ray = ray_through(*first, x, y);
      const double w[3] = {ray.o[0] + z * ray.d[0] - b.eye.x, ray.o[1] + z * ray.d[1] - b.eye.y,
                           ray.o[2] + z * ray.d[2] + (a.origin_z - b.origin_z) - b.eye.z};
      const auto along = [&](const Vec3& axis) {
        return w[0] * axis.x + w[1] * axis.y + w[2] * axis.z;
      };
      const double new_z = along(b.axes[2]);
      const int u = static_cast<int>(
          std::lround(along(b.axes[0]) / new_z * second->camera.fx + second->camera.cx));
      const int v = static_cast<int>(
          std::lround(along(b.axes[1]) / new_z * second->camera.fy + second->camera.cy));
      if (u < 1 || v < 1 || u > 318 || v > 238) continue;
      ++seen;
      if (std::abs(second->depth_at(u, v) - new_z) > 0.02 * new_z) continue;
      ++same_depth;
      for (int c = 0; c < 3; ++c) {
        colour_error += std::abs(first->colour_at(x, y)[c] - second->colour_at(u, v)[c]) / 3.0;
      }
    }
  }
  ASSERT_GT(seen, 20000);
  // The rest moved by itself, was hidden, or lies on an edge.
  EXPECT_GT(same_depth, seen * 9 / 10);
  EXPECT_LT(colour_error / same_depth, 12);
}

INSTANTIATE_TEST_SUITE_P(Scene, EveryKind, ::testing::Values(0, 1, 2, 3, 7, 11));

// ---- single shapes, by hand
// -----------------------------------------------------------------------

// An empty outdoor world seen from 2 m above the ground, straight ahead.
std::unique_ptr<Picture> empty_world() {
  auto picture = blank(101, 101, 90);
  Scene(0).at(0, picture->snapshot);
  Snapshot& s = picture->snapshot;
  s.count = 0;
  s.eye = {0, -2, 0};
  s.axes = {Vec3{1, 0, 0}, Vec3{0, 1, 0}, Vec3{0, 0, 1}};
  return picture;
}

Primitive shape_at(Shape shape, Vec3 centre, Vec3 half, float radius, float bound) {
  Primitive p;
  p.shape = shape;
  p.centre = centre;
  p.half = half;
  p.radius = radius;
  p.bound = bound;
  return p;
}

float centre_depth(Picture& picture, const Primitive& primitive) {
  picture.snapshot.count = 0;
  picture.snapshot.add(primitive);
  render(picture.snapshot, picture.camera, picture.rgb, picture.depth);
  return picture.depth_at(50, 50);
}

TEST(SceneDepth, OfSingleShapesIsWhatTheRulerSays) {
  const auto world = empty_world();
  const Vec3 none;
  EXPECT_FLOAT_EQ(centre_depth(*world, shape_at(Shape::kSphere, {0, -2, 5}, none, 1, 1)), 4);
  EXPECT_FLOAT_EQ(centre_depth(*world, shape_at(Shape::kBox, {0, -2, 6}, {1, 1, 2}, 0, 3)), 4);
  EXPECT_FLOAT_EQ(
      centre_depth(*world, shape_at(Shape::kCapsule, {0, -2, 8}, {0, 1, 0}, 0.25F, 1.25F)), 7.75F);
  // Seen through the middle of a hoop: the sky behind it. Its upper rim: the tube's front.
  const Primitive hoop = shape_at(Shape::kHoop, {0, -2, 4}, {1, 0, 0}, 0.1F, 1.1F);
  EXPECT_EQ(centre_depth(*world, hoop), 0);
  Primitive lowered = hoop;
  lowered.centre.y += 1;
  EXPECT_NEAR(centre_depth(*world, lowered), 3.9, 1e-5);
}

TEST(SceneDepth, OfTheGroundFollowsFromTheCamerasHeight) {
  const auto world = empty_world();
  render(world->snapshot, world->camera, world->rgb, world->depth);
  EXPECT_EQ(world->depth_at(50, 50), 0) << "the horizon is sky";
  for (const int y : {60, 75, 100}) {
    const float below = (static_cast<float>(y) - world->camera.cy) / world->camera.fy;
    EXPECT_NEAR(world->depth_at(30, y), 2 / below, 1e-4 / below);
  }
}

TEST(SceneDepth, ThinThingsFarAwayStaySharp) {
  // A pole of 8 cm at 60 m covers less than a pixel: a pixel centre on its axis sees its front.
  const auto world = empty_world();
  EXPECT_NEAR(centre_depth(*world, shape_at(Shape::kCapsule, {0, -2, 60}, {0, 2, 0}, 0.04F, 2.04F)),
              59.96, 1e-3);
}

TEST(ScenePicture, EdgesAreMixedFromBothSides) {
  const auto world = empty_world();
  Primitive box = shape_at(Shape::kBox, {0.43F, -2, 4}, {0.43F, 1, 0.1F}, 0, 1.2F);
  box.dark = box.light = {0, 0, 0};
  world->snapshot.add(box);
  render(world->snapshot, world->camera, world->rgb, world->depth);
  // The left edge, x = 0, runs through the middle of column 50.
  const int before = world->colour_at(48, 50)[2];
  const int edge = world->colour_at(50, 50)[2];
  EXPECT_LE(world->colour_at(53, 50)[2], 3);  // a little haze
  EXPECT_NEAR(edge, before / 2.0, before / 8.0);
}

// ---- seeds, time, threads, memory
// -----------------------------------------------------------------

TEST(SceneSeeds, TheSameSeedAndTimeGiveTheSameBytesOnEveryThread) {
  const auto reference = take(5, 12.5);
  std::vector<std::unique_ptr<Picture>> others(4);
  std::vector<std::thread> threads;
  threads.reserve(others.size());
  for (auto& other : others) threads.emplace_back([&other] { other = take(5, 12.5); });
  for (std::thread& thread : threads) thread.join();
  for (const auto& other : others) {
    EXPECT_EQ(other->rgb, reference->rgb);
    EXPECT_EQ(other->depth, reference->depth);
  }
}

TEST(SceneSeeds, DifferentSeedsAndTimesGiveDifferentPictures) {
  std::vector<std::unique_ptr<Picture>> pictures;
  for (std::uint64_t seed = 0; seed < 8; ++seed) pictures.push_back(take(seed, 1));
  pictures.push_back(take(0, 2));
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    for (std::size_t j = 0; j < i; ++j) EXPECT_NE(pictures[i]->rgb, pictures[j]->rgb);
  }
}

TEST(SceneSeeds, StreetsRoomsAndParksTakeTurns) {
  EXPECT_STREQ(Scene(0).kind_name(), "street");
  EXPECT_STREQ(Scene(1).kind_name(), "room");
  EXPECT_STREQ(Scene(2).kind_name(), "park");
  EXPECT_STREQ(Scene(3).kind_name(), "street");
}

TEST(SceneWorlds, NothingIsEverInTheCamerasFace) {
  for (std::uint64_t seed = 0; seed < 24; ++seed) {
    for (const double seconds : {0.0, 7.7, 31.0, 100.5}) {
      const auto picture = take(seed, seconds, 96, 72);
      int surfaces = 0;
      int close = 0;
      for (const float z : picture->depth) {
        if (z > 0) ++surfaces;
        if (z > 0 && z < 0.3F) ++close;
      }
      EXPECT_EQ(close, 0) << "seed " << seed << " at " << seconds;
      const bool indoor = picture->snapshot.indoor;
      EXPECT_GE(surfaces, indoor ? 96 * 72 : 96 * 72 * 2 / 5) << "seed " << seed;
      EXPECT_LT(picture->snapshot.count, Snapshot::kMaxPrimitives) << "seed " << seed;
    }
  }
}

// Mean absolute difference of two pictures, grey levels.
double difference(const Picture& a, const Picture& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.rgb.size(); ++i) sum += std::abs(a.rgb[i] - b.rgb[i]);
  return sum / static_cast<double>(a.rgb.size());
}

TEST(SceneWorlds, GoOnForEverWithoutAJump) {
  for (const std::uint64_t seed : {0U, 1U, 2U}) {
    // The local coordinates of a street move on every 64 m: some step here crosses that.
    double largest = 0;
    double sum = 0;
    int steps = 0;
    for (const double begin : {9.0, 40.0, 86'400.0}) {
      auto before = take(seed, begin, 96, 72);
      for (int i = 1; i <= 24; ++i) {
        auto now = take(seed, begin + i * 0.1, 96, 72);
        const double change = difference(*before, *now);
        largest = std::max(largest, change);
        sum += change;
        ++steps;
        before = std::move(now);
      }
    }
    EXPECT_LT(largest, 3 * sum / steps) << "seed " << seed;
    EXPECT_GT(sum / steps, 0.2) << "seed " << seed << " stands still";
  }
}

TEST(SceneRender, AllocatesNothing) {
  if (!alloc_watch::hooked()) GTEST_SKIP() << "built with a sanitizer, which owns malloc";
  const auto picture = blank(160, 120, 65);
  textures();
  const Scene scene(0);
  const std::uint64_t before = alloc_watch::thread_allocations();
  for (int i = 0; i < 5; ++i) {
    render(scene, i, picture->camera, picture->rgb, picture->depth);
    render(scene, i, picture->camera, picture->rgb, {});
  }
  EXPECT_EQ(alloc_watch::thread_allocations(), before);
}

TEST(SceneRender, EveryInstructionSetPaintsTheSamePicture) {
  for (const std::uint64_t seed : {0U, 1U, 2U}) {
    const auto best = take(seed, 5);
    test::for_each_isa([&] {
      const auto other = take(seed, 5);
      std::size_t wrong = 0;
      for (std::size_t i = 0; i < best->depth.size(); ++i) {
        if (std::abs(best->depth[i] - other->depth[i]) > 1e-3F * best->depth[i]) ++wrong;
      }
      EXPECT_LT(wrong, best->depth.size() / 500);
      double sum = 0;
      for (std::size_t i = 0; i < best->rgb.size(); ++i) {
        sum += std::abs(best->rgb[i] - other->rgb[i]);
      }
      EXPECT_LT(sum / static_cast<double>(best->rgb.size()), 0.2);
    });
  }
}

TEST(SceneRender, TakesSizesThatAreNoMultipleOfItsTiles) {
  const auto whole = take(1, 3, 160, 120);
  auto cut = blank(147, 101, 65);
  cut->camera = whole->camera;
  cut->camera.width = 147;
  cut->camera.height = 101;
  render(whole->snapshot, cut->camera, cut->rgb, cut->depth);
  for (const auto& [x, y] : {std::pair{0, 0}, {146, 0}, {146, 100}, {0, 100}, {77, 50}}) {
    EXPECT_EQ(cut->depth_at(x, y), whole->depth_at(x, y));
    for (int c = 0; c < 3; ++c) EXPECT_EQ(cut->colour_at(x, y)[c], whole->colour_at(x, y)[c]);
  }
}

}  // namespace
}  // namespace lcdm::scene
