// Rendered things in real pictures: where they may stand, and what becomes of picture and depth.
#include "model/pasted_things.h"

#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <memory>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "model/batch.h"

namespace lcdm::model {
namespace {

constexpr float kWall = 4;  // metres along the optical axis

// A grey room that is a floor and a wall across, as a sensor would see it: the camera 1.2 m high,
// looking down by `pitch` radians.
PackFrame room(float pitch, float height = 1.2F) {
  PackFrame frame;
  frame.name = "room";
  frame.camera = CameraModel::from_field_of_view(160, 120, 70);
  frame.rgb = cv::Mat(120, 160, CV_8UC3, cv::Scalar(150, 150, 150));
  frame.depth.create(120, 160, CV_32F);
  for (int y = 0; y < 120; ++y) {
    const float down = (static_cast<float>(y) - frame.camera.cy) / frame.camera.fy;
    const float sinking = down * std::cos(pitch) + std::sin(pitch);
    const float floor = sinking > 0 ? height / sinking : std::numeric_limits<float>::infinity();
    frame.depth.row(y).setTo(std::min(floor, kWall));
  }
  return frame;
}

// The first of the seeds whose things are put there.
std::uint64_t seed_that_pastes() {
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    PackFrame frame = room(0.3F);
    if (paste_things(seed, frame)) return seed;
  }
  ADD_FAILURE() << "no seed of 50 puts anything there";
  return 0;
}

TEST(LevelPlane, IsTheFloorHoweverTheCameraTilts) {
  for (const float pitch : {0.0F, 0.3F, 0.7F}) {
    const auto plane = find_level_plane(room(pitch), 3);
    ASSERT_TRUE(plane) << pitch;
    EXPECT_NEAR(plane->height, 1.2F, 0.06F) << pitch;
    EXPECT_NEAR(plane->up.y, -std::cos(pitch), 0.03F) << pitch;
    EXPECT_NEAR(plane->up.z, -std::sin(pitch), 0.03F) << pitch;
    EXPECT_NEAR(plane->up.x, 0, 0.03F) << pitch;
  }
}

TEST(LevelPlane, IsNoWallAndNoCeilingAndNeedsDepth) {
  PackFrame wall = room(0);
  wall.depth.setTo(2);
  EXPECT_FALSE(find_level_plane(wall, 3));
  PackFrame ceiling = room(0);
  cv::flip(ceiling.depth, ceiling.depth, 0);
  EXPECT_FALSE(find_level_plane(ceiling, 3));
  PackFrame unknown = room(0.3F);
  unknown.depth.setTo(0);
  EXPECT_FALSE(find_level_plane(unknown, 3));
}

TEST(PastedThings, StandInFrontOfWhatIsThereAndChangeNoOtherDepth) {
  const std::uint64_t seed = seed_that_pastes();
  const PackFrame bare = room(0.3F);
  PackFrame frame = room(0.3F);
  ASSERT_TRUE(paste_things(seed, frame));
  const cv::Mat changed = frame.depth != bare.depth;
  EXPECT_GT(cv::countNonZero(changed), 50);
  EXPECT_LT(cv::countNonZero(changed), 0.6 * static_cast<double>(changed.total()));
  EXPECT_EQ(cv::countNonZero(frame.depth > 1.03 * bare.depth), 0) << "nothing lies behind the wall";
  EXPECT_EQ(cv::countNonZero(frame.depth < 0.2), 0) << "nothing touches the camera";
  cv::Mat grey;
  cv::cvtColor(frame.rgb, grey, cv::COLOR_RGB2GRAY);
  cv::Mat others;
  cv::dilate(changed, others, cv::Mat::ones(9, 9, CV_8U));
  EXPECT_EQ(cv::countNonZero((grey > 151) & ~others), 0) << "shadows at most";
}

TEST(PastedThings, HaveDepthWhereTheSensorHadNone) {
  const std::uint64_t seed = seed_that_pastes();
  PackFrame whole = room(0.3F);
  ASSERT_TRUE(paste_things(seed, whole));
  const cv::Mat things = whole.depth != room(0.3F).depth;
  PackFrame holes = room(0.3F);
  // A hole above the floor: what is found level stays what it is.
  const cv::Rect upper(40, 20, 60, 25);
  holes.depth(upper).setTo(0);
  ASSERT_TRUE(paste_things(seed, holes));
  const cv::Mat unknown = holes.depth(upper) <= 0;
  EXPECT_EQ(cv::countNonZero(unknown & things(upper)), 0);
  EXPECT_EQ(cv::countNonZero(unknown), cv::countNonZero(~things(upper)));
}

TEST(PastedThings, AreTheSeedsAndLeaveSharedPixelsAlone) {
  const std::uint64_t seed = seed_that_pastes();
  const PackFrame original = room(0.3F);
  PackFrame first = original;  // shares its pixels
  PackFrame second = original;
  ASSERT_TRUE(paste_things(seed, first));
  ASSERT_TRUE(paste_things(seed, second));
  EXPECT_EQ(cv::norm(first.rgb, second.rgb), 0);
  EXPECT_EQ(cv::norm(first.depth, second.depth), 0);
  EXPECT_EQ(cv::norm(original.depth, room(0.3F).depth), 0);
  EXPECT_EQ(cv::norm(original.rgb, room(0.3F).rgb), 0);
}

TEST(PastedThings, StayOutOfPicturesWithoutALevelPlace) {
  PackFrame wall = room(0);
  wall.depth.setTo(2);
  const PackFrame before = wall;
  EXPECT_FALSE(paste_things(5, wall));
  EXPECT_EQ(cv::norm(wall.rgb, before.rgb), 0);
}

// How many of twenty training pictures have things in them.
class Furnished : public testing::Test {
 protected:
  static int furnished_pictures(float things, bool views) {
    Pack pack;
    pack.use.things = things;
    const PackFrame frame = room(0.3F);
    pack.frames = std::make_shared<MemoryFrames>(std::vector<PackFrame>{frame, frame, frame}, true);
    int sum = 0;
    for (std::uint64_t i = 0; i < 20; ++i) {
      SampleRandom random(1, i, 0);
      const BatchShape shape{64, 48, 60, 1, false, views};
      const Result<AugmentedSample> sample = augment(pack, 1, shape, random);
      EXPECT_TRUE(sample);
      // A bare room is of one grey.
      cv::Mat grey;
      cv::cvtColor(sample->plain, grey, cv::COLOR_RGB2GRAY);
      cv::Scalar mean;
      cv::Scalar deviation;
      cv::meanStdDev(grey, mean, deviation);
      sum += deviation[0] > 0.01 ? 1 : 0;
    }
    return sum;
  }
};

TEST_F(Furnished, AsOftenAsThePackIsToHaveThem) {
  EXPECT_EQ(furnished_pictures(0, false), 0);
  EXPECT_GE(furnished_pictures(1, false), 10);
}

TEST_F(Furnished, NotWhereNeighboursInTimeWouldShowNone) {
  EXPECT_EQ(furnished_pictures(1, true), 0);
}

}  // namespace
}  // namespace lcdm::model
