// Splits, packs on disk, rendered packs.
#include "model/pack.h"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <set>

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

// As ffmpeg names them with %d: frame 10 comes after frame 9, and of both kinds of file.
TEST_F(SmallPack, ReadsPicturesInTheirOrderInTime) {
  const fs::path rgb = root_ / "pack" / "rgb";
  fs::remove(rgb / "000000.jpg");
  const cv::Mat picture(48, 64, CV_8UC3, cv::Scalar(10, 100, 200));
  for (const char* name : {"10.jpg", "2.png", "1.jpg"}) cv::imwrite((rgb / name).string(), picture);
  use_.teacher = Teacher::kNone;
  const Result<Pack> pack = load_pack(root_, use_, 640);
  ASSERT_TRUE(pack) << pack.status().text();
  ASSERT_EQ(pack->frames->size(), 3U);
  EXPECT_EQ(pack->frames->name(0), "1");
  EXPECT_EQ(pack->frames->name(1), "2");
  EXPECT_EQ(pack->frames->name(2), "10");

  cv::imwrite((rgb / "2.jpg").string(), picture);
  const Result<Pack> twice = load_pack(root_, use_, 640);
  EXPECT_EQ(twice.code(), StatusCode::kInvalidInput);
  EXPECT_NE(std::string(twice.status().text()).find("2.png"), std::string::npos)
      << twice.status().text();
}

// What validates must not train where frames are left out: --every may differ from run to run.
TEST_F(SmallPack, KeepsFramesInTheirPartWhereSomeAreLeftOut) {
  const fs::path rgb = root_ / "pack" / "rgb";
  fs::remove(rgb / "000000.jpg");
  const cv::Mat picture(48, 64, CV_8UC3, cv::Scalar(10, 100, 200));
  for (int i = 0; i < 60; ++i) cv::imwrite((rgb / (std::to_string(i) + ".jpg")).string(), picture);
  use_.teacher = Teacher::kNone;
  const auto names = [](const Pack& pack, const std::vector<std::size_t>& part) {
    std::set<std::string> all;
    for (const std::size_t index : part) all.insert(pack.frames->name(index));
    return all;
  };
  const Result<Pack> whole = load_pack(root_, use_, 640);
  const Result<Pack> third = load_pack(root_, use_, 640, 3);
  ASSERT_TRUE(whole && third);
  EXPECT_EQ(third->frames->size(), 20U);
  EXPECT_EQ(names(*third, third->validation), (std::set<std::string>{"54", "57"}));
  for (const std::string& name : names(*third, third->train)) {
    EXPECT_EQ(names(*whole, whole->train).count(name), 1U) << name;
  }
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
                           R"({"fx": 100, "cx": null})", R"({"width": 0, "fx": 100})",
                           R"({"fx": 4.2})", R"({"fx": 1e5})", R"({"fx": 100, "cx": 900})"}) {
    write_intrinsics(text);
    const Result<Pack> pack = load_pack(root_, use_, 640);
    ASSERT_EQ(pack.code(), StatusCode::kCorrupt) << text;
    EXPECT_NE(std::string(pack.status().text()).find("intrinsics.json"), std::string::npos);
  }
}

// Files that lie side by side may have lost what was between them; names alone do not tell.
TEST(Neighbours, AreOfTheSameSequenceAndAboutAsFarApart) {
  const auto neighbours = [](const std::vector<std::string>& names) {
    std::vector<PackFrame> frames;
    for (const std::string& name : names) frames.push_back({name, {}, {}, {}});
    const MemoryFrames all(std::move(frames), true);
    std::vector<std::size_t> found;
    for (std::size_t i = 0; i < all.size(); ++i) {
      if (all.has_neighbours(i)) found.push_back(i);
    }
    return found;
  };
  using Indices = std::vector<std::size_t>;
  EXPECT_EQ(neighbours({"000", "001", "002", "900", "901", "902"}), (Indices{1, 4}));
  EXPECT_EQ(neighbours({"a_1", "a_2", "b_3", "b_4", "b_6"}), (Indices{3}));
  EXPECT_EQ(neighbours({"1305031102.10", "1305031102.14", "1305031102.17"}), (Indices{1}));
  EXPECT_EQ(neighbours({"left", "middle", "right"}), (Indices{1}));
  EXPECT_EQ(neighbours({"7", "7.", "7.0"}), (Indices{1})) << "no time between them is no gap";
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
