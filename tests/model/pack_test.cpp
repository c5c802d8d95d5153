// Splits, packs on disk, augmentation and batches.
#include "model/pack.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "model/batch.h"
#include "model/scene_pack.h"
#include "tests/support/temporary_folder.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;

std::vector<std::string> numbered(const std::string& prefix, std::size_t count) {
  std::vector<std::string> names;
  for (std::size_t i = 0; i < count; ++i) names.push_back(prefix + std::to_string(1000 + i));
  return names;
}

TEST(Split, ValidatesOnTheLastTenthBehindAGap) {
  const Split split = split_frames(numbered("", 100));
  ASSERT_EQ(split.train.size(), 70U);
  ASSERT_EQ(split.validation.size(), 10U);
  EXPECT_EQ(split.train.back(), 69U);
  EXPECT_EQ(split.validation.front(), 90U);
}

TEST(Split, TreatsEverySequenceByItself) {
  std::vector<std::string> names = numbered("a_", 50);
  const std::vector<std::string> second = numbered("b_", 50);
  names.insert(names.end(), second.begin(), second.end());
  const Split split = split_frames(names);
  EXPECT_EQ(split.train.size(), 50U);
  EXPECT_EQ(split.validation, (std::vector<std::size_t>{45, 46, 47, 48, 49, 95, 96, 97, 98, 99}));
}

TEST(Split, PartsAreDisjointAndShortSequencesOnlyTrain) {
  for (const std::size_t count : {1U, 33U, 34U, 57U, 400U}) {
    const Split split = split_frames(numbered("", count));
    for (const std::size_t index : split.train) {
      EXPECT_EQ(std::count(split.validation.begin(), split.validation.end(), index), 0);
    }
    EXPECT_EQ(split.validation.empty(), count < 34);
    EXPECT_FALSE(split.train.empty());
  }
}

PackFrame frame_of(const Pack& pack, std::size_t index = 0) { return *pack.frames->read(index); }

// A pack of one 64x48 frame: left half 2 m, right half unknown; fx 100.
class SmallPack : public testing::Test {
 protected:
  void SetUp() override {
    fs::create_directories(root_ / "pack" / "rgb");
    fs::create_directories(root_ / "pack" / "depth");
    cv::imwrite((root_ / "pack" / "rgb" / "000000.jpg").string(),
                cv::Mat(48, 64, CV_8UC3, cv::Scalar(10, 100, 200)));
    cv::Mat depth = cv::Mat::zeros(48, 64, CV_16U);
    depth.colRange(0, 32).setTo(2000);
    cv::imwrite((root_ / "pack" / "depth" / "000000.png").string(), depth);
    write_intrinsics(R"({"fx": 100, "fy": 100, "cx": 32, "cy": 24, "depth_unit_m": 0.001})");
  }
  void write_intrinsics(const std::string& text) {
    std::ofstream(root_ / "pack" / "intrinsics.json") << text;
  }

  test::TemporaryFolder scratch_;
  const fs::path root_ = scratch_.path();
  PackUse use_{.name = "pack", .wide_share = 1, .tall_share = 1, .maps = "maps"};
};

TEST_F(SmallPack, IsReadInMetres) {
  const Result<Pack> pack = load_pack(root_, use_, 640);
  ASSERT_TRUE(pack) << pack.status().text();
  EXPECT_FLOAT_EQ(frame_of(*pack).depth.at<float>(10, 10), 2);
  EXPECT_FLOAT_EQ(frame_of(*pack).depth.at<float>(10, 50), 0);
  EXPECT_FLOAT_EQ(frame_of(*pack).camera.fx, 100);
  EXPECT_NEAR(frame_of(*pack).rgb.at<cv::Vec3b>(20, 20)[0], 200, 4);  // red first
}

TEST_F(SmallPack, IsReducedWithItsIntrinsics) {
  const Result<Pack> pack = load_pack(root_, use_, 32);
  ASSERT_TRUE(pack);
  EXPECT_EQ(frame_of(*pack).rgb.size(), cv::Size(32, 24));
  EXPECT_FLOAT_EQ(frame_of(*pack).camera.fx, 50);
}

TEST_F(SmallPack, BadFilesAreNamed) {
  write_intrinsics("{");
  EXPECT_EQ(load_pack(root_, use_, 640).code(), StatusCode::kCorrupt);
  write_intrinsics(R"({"fx": 100, "depth_unit_m": -1})");
  EXPECT_EQ(load_pack(root_, use_, 640).code(), StatusCode::kCorrupt);
  fs::remove_all(root_ / "pack" / "rgb");
  EXPECT_EQ(load_pack(root_, use_, 640).code(), StatusCode::kNotFound);
}

// Intrinsics of 32x24 pictures beside pictures of 64x48.
// Stretched over the picture every depth would be in the wrong place.
TEST_F(SmallPack, RefusesDepthOfAnotherShape) {
  const auto load_with = [&](int width, int height) {
    cv::imwrite((root_ / "pack" / "depth" / "000000.png").string(),
                cv::Mat(height, width, CV_16U, cv::Scalar(2000)));
    return load_pack(root_, use_, 640);
  };
  EXPECT_TRUE(load_with(32, 24)) << "half the pixels of the same view";
  const Result<Pack> wide = load_with(64, 36);
  ASSERT_FALSE(wide);
  EXPECT_NE(std::string(wide.status().text()).find("64x36 pixels is not registered"),
            std::string::npos)
      << wide.status().text();
}

TEST_F(SmallPack, ScalesIntrinsicsOfAnotherSizeOfTheSameShape) {
  write_intrinsics(R"({"width": 32, "height": 24, "fx": 50, "fy": 52, "cx": 15.5, "cy": 11.5})");
  const Result<Pack> pack = load_pack(root_, use_, 640);
  ASSERT_TRUE(pack) << pack.status().text();
  const CameraModel camera = frame_of(*pack).camera;
  EXPECT_EQ(camera.width, 64);
  EXPECT_FLOAT_EQ(camera.fx, 100);
  EXPECT_FLOAT_EQ(camera.fy, 104);
  EXPECT_FLOAT_EQ(camera.cx, 31.5);
  EXPECT_FLOAT_EQ(camera.cy, 23.5);
}

TEST_F(SmallPack, TakesSquarePixelsAndTheCentreWhereOnlyFxIsKnown) {
  write_intrinsics(R"({"fx": 100})");
  const Result<Pack> pack = load_pack(root_, use_, 640);
  ASSERT_TRUE(pack) << pack.status().text();
  const CameraModel camera = frame_of(*pack).camera;
  EXPECT_FLOAT_EQ(camera.fy, 100);
  EXPECT_FLOAT_EQ(camera.cx, 31.5);
  EXPECT_FLOAT_EQ(camera.cy, 23.5);
}

TEST_F(SmallPack, RefusesIntrinsicsThatCannotBe) {
  for (const char* text : {R"({"width": 64, "height": 64, "fx": 100})", R"({"fx": -100})",
                           R"({"fx": 0})", R"({"fx": "100"})", R"({"fx": 100, "fy": -1})",
                           R"({"fx": 100, "cx": null})", R"({"width": 0, "fx": 100})"}) {
    write_intrinsics(text);
    const Result<Pack> pack = load_pack(root_, use_, 640);
    ASSERT_EQ(pack.code(), StatusCode::kCorrupt) << text;
    EXPECT_NE(std::string(pack.status().text()).find("intrinsics.json"), std::string::npos);
  }
}

// Depth would have no scale, and nobody told.
TEST_F(SmallPack, WithoutFxNeedsAFieldOfView) {
  write_intrinsics("{}");
  const Result<Pack> pack = load_pack(root_, use_, 640);
  ASSERT_EQ(pack.code(), StatusCode::kInvalidInput);
  EXPECT_NE(std::string(pack.status().text()).find("field-of-view"), std::string::npos);
  use_.field_of_view = 90;
  const Result<Pack> assumed = load_pack(root_, use_, 640);
  ASSERT_TRUE(assumed) << assumed.status().text();
  EXPECT_FLOAT_EQ(frame_of(*assumed).camera.fx, 32);
  EXPECT_FALSE(frame_of(*assumed).camera.calibrated);
}

// A JPEG that lost its end would train as a picture with a grey lower half.
TEST_F(SmallPack, SkipsAndNamesATruncatedPicture) {
  const fs::path cut = root_ / "pack" / "rgb" / "000001.jpg";
  cv::Mat noise(480, 640, CV_8UC3);
  cv::randu(noise, 0, 255);
  cv::imwrite(cut.string(), noise);
  fs::resize_file(cut, fs::file_size(cut) * 37 / 100);
  fs::copy_file(root_ / "pack" / "depth" / "000000.png", root_ / "pack" / "depth" / "000001.png");
  const Result<Pack> pack = load_pack(root_, use_, 640);
  ASSERT_TRUE(pack) << pack.status().text();
  EXPECT_TRUE(pack->frames->read(0));
  const Result<PackFrame> broken = pack->frames->read(1);
  ASSERT_EQ(broken.code(), StatusCode::kCorrupt);
  EXPECT_NE(std::string(broken.status().text()).find("000001.jpg"), std::string::npos);
  const Result<Batch> batch = make_batch({*pack}, {96, 64, 80, 8, false}, 1, 1);
  ASSERT_TRUE(batch) << batch.status().text();
  EXPECT_GT(batch->unreadable, 0) << "counted, and another one drawn";
}

TEST_F(SmallPack, CropKeepsDepthAtTheCanonicalFocalLength) {
  const Result<Pack> pack = load_pack(root_, use_, 640);
  ASSERT_TRUE(pack);
  BatchShape shape{96, 64, 80, 1, false};
  for (std::uint64_t seed = 0; seed < 8; ++seed) {
    SampleRandom random(seed, 0, 0);
    const AugmentedSample sample = *augment(*pack, 0, shape, random);
    double most = 0;
    cv::minMaxLoc(sample.depth, nullptr, &most);
    if (most > 0) {
      EXPECT_NEAR(most, 2 * 80 / sample.camera.fx, 1e-4);
    }
    EXPECT_GE(sample.camera.fx, 99.0F * 96 / 64);  // a crop only ever enlarges
    double low = 0;
    double high = 0;
    cv::minMaxLoc(sample.rgb.reshape(1), &low, &high);
    EXPECT_GE(low, 0);
    EXPECT_LE(high, 1);
  }
}

TEST_F(SmallPack, BatchIsAFunctionOfSeedAndStep) {
  const Result<Pack> pack = load_pack(root_, use_, 640);
  ASSERT_TRUE(pack);
  const std::vector<Pack> packs = {*pack};
  const BatchShape shape{96, 64, 80, 2, false};
  const Batch a = *make_batch(packs, shape, 1, 5);
  EXPECT_TRUE(torch::equal(a.rgb, make_batch(packs, shape, 1, 5)->rgb));
  EXPECT_FALSE(torch::equal(a.rgb, make_batch(packs, shape, 1, 6)->rgb));
  EXPECT_FALSE(torch::equal(a.rgb, make_batch(packs, shape, 2, 5)->rgb));
  BatchLoader loader(packs, {shape}, 1, 4, 2);
  ASSERT_TRUE(loader.next());
  EXPECT_TRUE(torch::equal(a.rgb, loader.next()->rgb));
}

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
  bool has_neighbours(std::size_t /*index*/) const override { return false; }
  Result<cv::Mat> neighbour(std::size_t /*index*/, int /*offset*/) const override {
    return Status::error(StatusCode::kNotFound, "none");
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

TEST(ScenePack, ValidatesOnUnseenWorlds) {
  ScenePackOptions options;
  options.train_frames = 6;
  options.validation_frames = 2;
  const Pack pack = rendered_pack(options);
  ASSERT_EQ(pack.frames->size(), 8U);
  for (const std::size_t index : pack.validation) {
    EXPECT_EQ(std::count(pack.train.begin(), pack.train.end(), index), 0);
  }
  double least = 0;
  cv::minMaxLoc(frame_of(pack).depth, &least, nullptr);
  EXPECT_GT(least, 0);  // no holes: the sky is far
}

TEST(ScenePack, RendersAFrameAnewAndAlike) {
  for (const Rendering rendering : {Rendering::kScene, Rendering::kMedley}) {
    ScenePackOptions options;
    options.rendering = rendering;
    options.train_frames = 400000;  // none of them is kept
    const Pack pack = rendered_pack(options);
    const PackFrame once = *pack.frames->read(123456);
    const PackFrame again = *pack.frames->read(123456);
    EXPECT_EQ(cv::norm(once.rgb, again.rgb, cv::NORM_INF), 0);
    EXPECT_EQ(cv::norm(once.depth, again.depth, cv::NORM_INF), 0);
    EXPECT_GT(cv::norm(once.rgb, pack.frames->read(123460)->rgb, cv::NORM_INF), 0);
  }
}

TEST(InverseResize, KeepsHoles) {
  const cv::Mat depth = (cv::Mat_<float>(1, 3) << 2, 2, 0);
  const cv::Mat out = resize_inverse(depth, {6, 1});
  for (int x = 0; x < 3; ++x) EXPECT_FLOAT_EQ(out.at<float>(0, x), 2) << x;
  for (int x = 3; x < 6; ++x) EXPECT_FLOAT_EQ(out.at<float>(0, x), 0) << x << ": nothing of a hole";
}

}  // namespace
}  // namespace lcdm::model
