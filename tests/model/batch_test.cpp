// Augmentation and batches: what is drawn still says what its picture shows.
#include "model/batch.h"

#include <cmath>
#include <gtest/gtest.h>
#include <memory>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "model/pack.h"
#include "model/scene_pack.h"

namespace lcdm::model {
namespace {

// A picture that shows its own depth: what is augmented must go on doing so.
TEST(Augmentation, TakesDepthWhereItTakesThePicture) {
  PackFrame frame{"slope", cv::Mat(96, 128, CV_8UC3), cv::Mat(96, 128, CV_32F),
                  CameraModel::from_field_of_view(128, 96, 60)};
  for (int y = 0; y < 96; ++y) {
    for (int x = 0; x < 128; ++x) {
      const int level = 20 + x + y;
      frame.rgb.at<cv::Vec3b>(y, x) = cv::Vec3b::all(static_cast<std::uint8_t>(level));
      frame.depth.at<float>(y, x) = static_cast<float>(level) / 255;
    }
  }
  Pack pack;
  pack.frames = std::make_shared<MemoryFrames>(std::vector<PackFrame>{frame}, false);
  int with_holes = 0;
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    SampleRandom random(seed, 0, 0);
    const AugmentedSample sample = *augment(pack, 0, {64, 48, 60, 1, false}, random);
    const float zoom = 60 / sample.camera.fx;
    for (int y = 0; y < 48; ++y) {
      for (int x = 0; x < 64; ++x) {
        const float depth = sample.depth.at<float>(y, x);
        if (depth > 0) {
          EXPECT_NEAR(depth / zoom, sample.plain.at<cv::Vec3f>(y, x)[0], 2.2 / 255) << seed;
        }
      }
    }
    if (cv::countNonZero(sample.depth) < 64 * 48) ++with_holes;
  }
  EXPECT_GE(with_holes, 1) << "no picture was rolled";
  EXPECT_LE(with_holes, 15);
}

// ---- Where a known point is seen after augmentation
// ----------------------------------------------

// A spot of light in one colour.
void draw_spot(cv::Mat& rgb, int colour, const Point& at) {
  for (int y = 0; y < rgb.rows; ++y) {
    for (int x = 0; x < rgb.cols; ++x) {
      const double distance = std::hypot(x - at.x, y - at.y);
      rgb.at<cv::Vec3b>(y, x)[colour] =
          static_cast<std::uint8_t>(255 * std::exp(-distance * distance / 18));
    }
  }
}

// Its centre; nothing where it is cut off or too near the border to be whole.
std::optional<Point> find_spot(const cv::Mat& rgb, int colour) {
  constexpr double kMargin = 20;
  cv::Mat plane;
  cv::extractChannel(rgb, plane, colour);
  const cv::Moments moments = cv::moments(plane);
  const Point centre{moments.m10 / moments.m00, moments.m01 / moments.m00};
  const bool whole = centre.x > kMargin && centre.x < rgb.cols - kMargin && centre.y > kMargin &&
                     centre.y < rgb.rows - kMargin;
  return whole ? std::optional(centre) : std::nullopt;
}

// Red to the left of green, seen by a camera whose fx, fy, cx and cy all differ.
class KnownPoints : public testing::Test {
 protected:
  KnownPoints() {
    cv::Mat rgb = cv::Mat::zeros(240, 320, CV_8UC3);
    for (const int colour : {0, 1}) draw_spot(rgb, colour, camera_.project(kRays[colour]));
    std::vector<PackFrame> frames;
    for (const char* name : {"0", "1", "2"}) {
      frames.push_back({name, rgb, cv::Mat(240, 320, CV_32F, cv::Scalar(3)), camera_});
    }
    pack_.frames = std::make_shared<MemoryFrames>(frames, true);
  }
  AugmentedSample sample(std::uint64_t seed, bool views) const {
    BatchShape shape{160, 120, 130, 1, false};
    shape.views = views;
    SampleRandom random(seed, 0, 0);
    return *augment(pack_, 1, shape, random);
  }

  static constexpr Point kRays[2] = {{-0.1, -0.05}, {0.12, 0.09}};
  CameraModel camera_{320, 240, 260, 250, 170.5F, 112.25F, true};
  Pack pack_;
};

TEST_F(KnownPoints, LandOnTheirPixelsAfterCropResizeAndFlip) {
  int found[2] = {};  // as they are, flipped
  for (std::uint64_t seed = 0; seed < 40; ++seed) {
    const AugmentedSample out = sample(seed, true);
    const auto red = find_spot(out.plain, 0);
    const auto green = find_spot(out.plain, 1);
    if (!red || !green) continue;
    const bool flipped = red->x > green->x;
    ++found[flipped ? 1 : 0];
    for (const auto& [spot, ray] : {std::pair(*red, kRays[0]), std::pair(*green, kRays[1])}) {
      const Point expected = out.camera.project({flipped ? -ray.x : ray.x, ray.y});
      EXPECT_NEAR(spot.x, expected.x, 0.25) << seed;
      EXPECT_NEAR(spot.y, expected.y, 0.25) << seed;
    }
  }
  EXPECT_GT(found[0], 5);
  EXPECT_GT(found[1], 5);
}

TEST_F(KnownPoints, AreWhereTheyWereInNeighboursThatShowTheSame) {
  for (std::uint64_t seed = 0; seed < 8; ++seed) {
    const AugmentedSample out = sample(seed, true);
    EXPECT_EQ(cv::norm(out.plain, out.earlier, cv::NORM_INF), 0);
    EXPECT_EQ(cv::norm(out.plain, out.later, cv::NORM_INF), 0);
  }
}

// A roll about the optical axis turns rays and keeps their angle to it.
TEST_F(KnownPoints, KeepTheirAngleToTheAxisWhenTheCameraRolls) {
  camera_.fy = camera_.fx;  // a roll is a turn of square pixels
  PackFrame frame = *pack_.frames->read(1);
  frame.camera = camera_;
  draw_spot(frame.rgb, 0, camera_.project(kRays[0]));
  pack_.frames = std::make_shared<MemoryFrames>(std::vector<PackFrame>(3, frame), false);
  int rolled = 0;
  for (std::uint64_t seed = 0; seed < 80; ++seed) {
    const AugmentedSample out = sample(seed, false);
    const auto red = find_spot(out.plain, 0);
    if (!red) continue;
    const Point ray = *out.camera.unproject(*red);
    EXPECT_NEAR(std::hypot(ray.x, ray.y), std::hypot(kRays[0].x, kRays[0].y), 2e-3) << seed;
    if (std::abs(ray.y - kRays[0].y) > 5e-3) ++rolled;
  }
  EXPECT_GT(rolled, 5);
}

// Frames of which every second cannot be read.
class DamagedFrames final : public Frames {
 public:
  explicit DamagedFrames(bool all) : all_(all) {}
  std::size_t size() const override { return 20; }
  std::string name(std::size_t index) const override { return std::to_string(index); }
  Result<PackFrame> read(std::size_t index) const override {
    if (all_ || index % 2 == 1) {
      return Status::error(StatusCode::kCorrupt, "%zu.jpg is not a picture", index);
    }
    return PackFrame{name(index), cv::Mat(48, 64, CV_8UC3, cv::Scalar::all(9)),
                     cv::Mat(48, 64, CV_32F, cv::Scalar(2)),
                     CameraModel::from_field_of_view(64, 48, 60)};
  }

 private:
  bool all_;
};

std::vector<Pack> damaged_packs(bool all) {
  Pack pack;
  pack.use.wide_share = pack.use.tall_share = 1;
  pack.frames = std::make_shared<DamagedFrames>(all);
  for (std::size_t i = 0; i < pack.frames->size(); ++i) pack.train.push_back(i);
  return {pack};
}

TEST(Batches, CountAndReplaceFramesThatCannotBeRead) {
  const Result<Batch> batch = make_batch(damaged_packs(false), {96, 64, 80, 16, false}, 1, 5);
  ASSERT_TRUE(batch) << batch.status().text();
  EXPECT_GT(batch->unreadable, 0);
  EXPECT_NE(std::string(batch->why_unreadable.text()).find(".jpg is not a picture"),
            std::string::npos);
  EXPECT_TRUE((batch->target.depth > 0).flatten(1).any(1).all().item<bool>());
}

TEST(Batches, FailByNameWhereNoFrameCanBeRead) {
  const Result<Batch> batch = make_batch(damaged_packs(true), {96, 64, 80, 2, false}, 1, 5);
  ASSERT_EQ(batch.code(), StatusCode::kCorrupt);
  EXPECT_NE(std::string(batch.status().text()).find(".jpg is not a picture"), std::string::npos);
}

// What a second process takes of a shared batch is the second half of the whole batch.
TEST(Batches, AreSharedByProcesses) {
  ScenePackOptions options;
  options.train_frames = 4;
  options.validation_frames = 0;
  const std::vector<Pack> packs = {rendered_pack(options)};
  BatchShape shape{96, 64, 80, 4, false};
  const Batch whole = *make_batch(packs, shape, 3, 1);
  shape.images = 2;
  shape.first = 2;
  EXPECT_TRUE(torch::equal(make_batch(packs, shape, 3, 1)->rgb, whole.part(2, 2).rgb));
}

// Two sizes in one sequence cannot be cut alike.
TEST(Batches, RefuseANeighbourOfAnotherSize) {
  std::vector<PackFrame> frames;
  for (const cv::Size size : {cv::Size(64, 48), cv::Size(64, 48), cv::Size(32, 24)}) {
    frames.push_back({std::to_string(frames.size()), cv::Mat(size, CV_8UC3, cv::Scalar::all(9)),
                      cv::Mat(size, CV_32F, cv::Scalar(2)),
                      CameraModel::from_field_of_view(size.width, size.height, 60)});
  }
  Pack pack;
  pack.frames = std::make_shared<MemoryFrames>(frames, true);
  BatchShape shape{96, 64, 80, 1, false};
  shape.views = true;
  SampleRandom random(1, 0, 0);
  const Result<AugmentedSample> sample = augment(pack, 1, shape, random);
  ASSERT_EQ(sample.code(), StatusCode::kCorrupt);
  EXPECT_NE(std::string(sample.status().text()).find("32x24"), std::string::npos);
}

}  // namespace
}  // namespace lcdm::model
