// What is measured over whole sets, and how sure a difference is.
#include "model/evaluation.h"

#include <algorithm>
#include <cmath>
#include <gtest/gtest.h>
#include <random>

#include "model/validation.h"

namespace lcdm::model {
namespace {

SetResult result_of(const std::vector<double>& abs_rel) {
  SetResult result;
  for (std::size_t i = 0; i < abs_rel.size(); ++i) {
    FrameResult frame;
    frame.name = std::to_string(i);
    frame.metrics.abs_rel = abs_rel[i];
    result.frames.push_back(frame);
  }
  return result;
}

TEST(PairedDifference, OfAConstantDifferenceHasNoSpread) {
  const Difference d =
      paired_difference(result_of({0.3, 0.5, 0.9}), result_of({0.2, 0.4, 0.8}), &Metrics::abs_rel);
  EXPECT_EQ(d.frames, 3U);
  EXPECT_NEAR(d.mean, 0.1, 1e-12);
  EXPECT_NEAR(d.low, 0.1, 1e-12);
  EXPECT_NEAR(d.high, 0.1, 1e-12);
}

double half_width(const std::vector<double>& differences) {
  const Difference d =
      paired_difference(result_of(differences),
                        result_of(std::vector<double>(differences.size(), 0)), &Metrics::abs_rel);
  return (d.high - d.low) / 2;
}

// Differences of +1 and -1, each by a coin: the mean of 400 of them has a deviation of 1/20, and 95
// % of its draws lie within 1.96 of that.
TEST(PairedDifference, OfFramesThatAreIndependentHasTheIntervalOfTheNormalLaw) {
  std::mt19937 coin(1);
  std::vector<double> differences(400);
  for (double& difference : differences) difference = coin() % 2 == 0 ? 1 : -1;
  EXPECT_NEAR(half_width(differences), 1.96 / 20, 0.02);
}

// Twenty neighbours have one coin: only twenty frames in truth, with a deviation of 1/sqrt(20).
TEST(PairedDifference, OfFramesThatResembleTheirNeighboursIsLessSure) {
  std::mt19937 coin(1);
  std::vector<double> differences(400);
  for (std::size_t i = 0; i < 400; i += 20) {
    std::fill_n(differences.begin() + static_cast<std::ptrdiff_t>(i), 20, coin() % 2 == 0 ? 1 : -1);
  }
  EXPECT_GT(half_width(differences), 0.6 * 1.96 / std::sqrt(20.0));
}

TEST(PairedDifference, ComparesOnlyFramesThatBothHave) {
  SetResult a = result_of({0.5, 0.5});
  SetResult b = result_of({0.1, 0.4});
  b.frames[0].name = "another";
  const Difference d = paired_difference(a, b, &Metrics::abs_rel);
  EXPECT_EQ(d.frames, 1U);
  EXPECT_NEAR(d.mean, 0.1, 1e-12);
}

// A step edge blurred along x becomes a ramp of the stated length.
TEST(MotionBlur, HasTheStatedLength) {
  cv::Mat rgb(20, 640, CV_8UC3, cv::Scalar::all(0));
  rgb.colRange(320, 640).setTo(cv::Scalar::all(250));
  const cv::Mat blurred = motion_blurred(rgb, 20, 0);
  int between = 0;
  for (int x = 0; x < 640; ++x) {
    const int value = blurred.at<cv::Vec3b>(10, x)[0];
    if (value > 0 && value < 250) ++between;
  }
  EXPECT_NEAR(between, 20, 1);
  EXPECT_NEAR(blurred.at<cv::Vec3b>(10, 320)[1], 125, 10);
}

TEST(MotionBlur, LeavesAFlatPictureAlone) {
  const cv::Mat rgb(30, 64, CV_8UC3, cv::Scalar(10, 200, 90));
  for (const std::size_t index : {0U, 1U, 2U}) {
    EXPECT_LE(cv::norm(motion_blurred(rgb, 60, index), rgb, cv::NORM_INF), 1);
  }
}

TEST(Evaluate, CountsFramesWithoutAnEstimate) {
  std::vector<PackFrame> frames(3);
  for (std::size_t i = 0; i < frames.size(); ++i) {
    frames[i] = {std::to_string(i), cv::Mat(8, 8, CV_8UC3), cv::Mat(8, 8, CV_32F, cv::Scalar(2)),
                 CameraModel::from_field_of_view(8, 8, 60)};
  }
  frames[1].depth.setTo(0);  // no ground truth
  const MemoryFrames set(frames, false);
  const SetResult result = evaluate(
      set, {0, 1, 2}, *protocol_named("indoor"),
      [](const PackFrame& frame) { return frame.name == "2" ? cv::Mat() : frame.depth.clone(); });
  EXPECT_EQ(result.missing, 2U);
  EXPECT_STREQ(result.why_missing.text(), "2: no estimate");
  ASSERT_EQ(result.frames.size(), 1U);
  EXPECT_EQ(result.frames[0].name, "0");
}

// Metres come back: canonical depth times the focal length at the input over the canonical one.
TEST(NetworkEstimator, GivesMetres) {
  ModelConfig config;
  config.encoder = EncoderKind::kXxs;
  config.canonical_focal = 320;
  DepthNetwork network(config);
  network->eval();
  PackFrame frame;
  frame.rgb = cv::Mat(192, 640, CV_8UC3, cv::Scalar::all(100));
  frame.camera = CameraModel{640, 192, 320, 320, 319.5F, 95.5F, true};
  const Estimator estimator = network_estimator(network, 0, 0.25);
  const cv::Mat canonical = estimator(frame);
  frame.camera.fx = 640;
  EXPECT_NEAR(cv::norm(estimator(frame), 2 * canonical, cv::NORM_INF), 0, 1e-4);
}

// A teacher that believes everything on a picture's left to be at 1 m, on its right at 3: of a
// picture and its mirror it says 1.5 m everywhere. What it does not know in one is not known.
TEST(BothWays, IsTheMeanInverseDepthOfAPictureAndOfItsMirror) {
  const Estimator left_is_near = [](const PackFrame& frame) {
    cv::Mat depth(frame.rgb.size(), CV_32F, cv::Scalar(3));
    depth.colRange(0, 4).setTo(1);
    if (frame.rgb.at<cv::Vec3b>(0, 7)[0] == 9) depth.at<float>(2, 7) = 0;
    return depth;
  };
  PackFrame frame;
  frame.rgb = cv::Mat(4, 8, CV_8UC3, cv::Scalar::all(0));
  frame.rgb.at<cv::Vec3b>(0, 7)[0] = 9;
  const cv::Mat depth = both_ways(left_is_near)(frame);
  ASSERT_EQ(depth.size(), frame.rgb.size());
  EXPECT_EQ(depth.at<float>(2, 7), 0) << "unknown in the picture";
  EXPECT_EQ(cv::countNonZero(depth == 1.5F), 31);
  EXPECT_TRUE(both_ways([](const PackFrame&) { return cv::Mat(); })(frame).empty());
}

// What a camera sees mirrored it sees with its centre mirrored.
TEST(BothWays, MirrorsTheCameraToo) {
  PackFrame frame;
  frame.rgb = cv::Mat(4, 8, CV_8UC3, cv::Scalar::all(0));
  frame.camera.cx = 2;
  std::vector<float> centres;
  both_ways([&centres](const PackFrame& seen) {
    centres.push_back(seen.camera.cx);
    return cv::Mat(seen.rgb.size(), CV_32F, cv::Scalar(1));
  })(frame);
  EXPECT_EQ(centres, (std::vector<float>{2, 5}));
}

DepthNetwork small_network() {
  ModelConfig config;
  config.encoder = EncoderKind::kXxs;
  DepthNetwork network(config);
  network->eval();
  return network;
}

// A set of one random frame.
Pack pack_of(Teacher teacher) {
  PackFrame frame{"0", cv::Mat(48, 64, CV_8UC3), cv::Mat(48, 64, CV_32F),
                  CameraModel::from_field_of_view(64, 48, 60)};
  cv::randu(frame.rgb, 0, 255);
  cv::randu(frame.depth, 1, 9);
  Pack pack;
  pack.use.teacher = teacher;
  pack.frames = std::make_shared<MemoryFrames>(std::vector<PackFrame>{frame}, false);
  pack.validation = {0};
  return pack;
}

// A sensor's depth where there is some, else renderings, else the teacher's maps.
TEST(Validate, ScoresOnTheDepthThatIsBelievedMost) {
  DepthNetwork network = small_network();
  Data data;
  data.packs = {pack_of(Teacher::kMaps), pack_of(Teacher::kRenderer), pack_of(Teacher::kSensor)};
  data.protocols.resize(3);
  while (!data.packs.empty()) {
    const Validation validation = validate(network, 0, 0.25, data, 8);
    ASSERT_EQ(validation.sets.size(), data.packs.size());
    const Validation::Set& last = validation.sets.back();
    EXPECT_DOUBLE_EQ(validation.score, last.network.abs_rel / last.constant.abs_rel);
    data.packs.pop_back();
  }
}

// Pictures for the photometric loss alone: nothing to measure by, and no fault.
TEST(Validate, LeavesOutWhatHasNoDepth) {
  DepthNetwork network = small_network();
  Data data;
  data.packs = {pack_of(Teacher::kSensor), pack_of(Teacher::kNone)};
  data.protocols.resize(2);
  const Validation validation = validate(network, 0, 0.25, data, 8);
  EXPECT_EQ(validation.sets.size(), 1U);
  EXPECT_TRUE(validation.fault);
  EXPECT_TRUE(std::isfinite(validation.score));
}

// Not 0, than which no later score could be better.
TEST(Validate, WithoutAFrameHasNoScore) {
  DepthNetwork network{ModelConfig{}};
  EXPECT_TRUE(std::isinf(validate(network, 0, 0.25, Data{}, 8).score));
}

// A score of what is left would be of another kind: none, and why is told.
TEST(Validate, WithoutASetThatItShouldHaveHasNoScore) {
  DepthNetwork network = small_network();
  Data data;
  data.packs = {pack_of(Teacher::kRenderer), pack_of(Teacher::kSensor)};
  data.protocols.resize(2);
  const Status gone = Status::error(StatusCode::kNotFound, "depth/0.png is gone");
  data.packs[1].frames = std::make_shared<MemoryFrames>(
      std::vector<PackFrame>{{"0", {}, {}, {}}}, false, std::map<std::size_t, Status>{{0, gone}});
  const Validation validation = validate(network, 0, 0.25, data, 8);
  EXPECT_TRUE(std::isinf(validation.score));
  EXPECT_STREQ(validation.fault.text(), "depth/0.png is gone");
}

// The file with LibTorch and in the engine, at the deployed size and at another: the same depth.
TEST(EngineEstimator, IsFedAsTheFileIs) {
  const std::string path = "model/weights/lcdm-xxs.safetensors";
  const Result<ModelFile> model = ModelFile::load(path);
  ASSERT_TRUE(model);
  PackFrame frame;
  frame.rgb = cv::Mat(288, 384, CV_8UC3);
  cv::randu(frame.rgb, 0, 255);
  frame.camera = CameraModel::from_field_of_view(384, 288, 60);
  for (const double share : {1.0, 0.42}) {
    const Result<Estimator> file = file_estimator(path, share);
    const Result<Estimator> engine = engine_estimator(path, Precision::kFloat32, 1, share);
    ASSERT_TRUE(file && engine);
    const cv::Mat depth = (*engine)(frame);
    ASSERT_EQ(depth.size(), deployed_size(model->config(), frame.rgb.size(), share));
    ASSERT_EQ(depth.size(), (*file)(frame).size());
    EXPECT_LT(log_distance(depth, (*file)(frame)), 1e-4);
  }
}

TEST(EngineEstimator, SaysWhatItCannotRead) {
  EXPECT_FALSE(engine_estimator("nowhere.safetensors", Precision::kFloat32, 1));
}

}  // namespace
}  // namespace lcdm::model
