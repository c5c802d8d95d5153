// The engine held to LibTorch, layer by layer, on real pictures at the deployed sizes: weights are
// random and of real shape, so that no layer can hide behind a trained one's small values.
#include <cmath>
#include <filesystem>
#include <gtest/gtest.h>
#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <ostream>
#include <string>
#include <tuple>
#include <vector>

#include "firmware/nn/engine.h"
#include "model/folded_net.h"
#include "tests/support/random_model.h"
#include "tests/support/worse.h"

namespace lcdm::model {
namespace {

// max|a - b| <= kTensorTolerance * max|b| for every layer; relative for every pixel of the depth.
constexpr double kTensorTolerance = 1e-4;
constexpr double kDepthTolerance = 1e-4;

struct GoldenCase {
  EncoderKind encoder;
  PresetKind preset;
  int width;
  int height;
};

std::string name_of(const GoldenCase& c) {
  return std::string(to_string(c.encoder)) + "_" + to_string(c.preset) + "_" +
         std::to_string(c.width) + "x" + std::to_string(c.height);
}
void PrintTo(const GoldenCase& c, std::ostream* out) { *out << name_of(c); }

class EngineGoldenTest : public ::testing::TestWithParam<GoldenCase> {};

// A real picture as the network sees it: [height, width, 3], normalised.
cv::Mat real_picture(int width, int height) {
  const char* file = width > 2 * height ? "/usr/share/doc/opencv-doc/examples/data/aloeL.jpg"
                                        : "/usr/share/doc/opencv-doc/examples/data/home.jpg";
  cv::Mat picture = cv::imread(file);
  if (picture.empty()) return picture;
  cv::cvtColor(picture, picture, cv::COLOR_BGR2RGB);
  cv::resize(picture, picture, {width, height}, 0, 0, cv::INTER_AREA);
  picture.convertTo(picture, CV_32F, 1 / (255 * 0.225), -0.45 / 0.225);
  return picture;
}

std::unique_ptr<Engine> prepare_engine(const ModelFile& file, int width, int height) {
  EngineOptions options;
  options.width = width;
  options.height = height;
  options.threads = 2;
  options.keep_tensors = true;
  CameraModel camera = CameraModel::from_field_of_view(width, height, 65);
  camera.fx = static_cast<float>(file.config().canonical_focal);  // depth comes out canonical
  auto engine =
      Engine::prepare(file, options, {PixelFormat::kRgb24, width, height, width * 3}, camera);
  EXPECT_TRUE(engine) << engine.status().text();
  return engine ? std::move(*engine) : nullptr;
}

// NHWC as the engine keeps it against [1, channels, h, w].
void expect_same(const std::string& layer, std::span<const float> got, const at::Tensor& want) {
  const at::Tensor nhwc = want.permute({0, 2, 3, 1}).contiguous();
  ASSERT_EQ(static_cast<int64_t>(got.size()), nhwc.numel()) << layer;
  const float* expected = nhwc.data_ptr<float>();
  double worst = 0;
  double largest = 0;
  for (std::size_t i = 0; i < got.size(); ++i) {
    worst = test::worse(worst, std::abs(static_cast<double>(got[i]) - expected[i]));
    largest = std::max(largest, std::abs(static_cast<double>(expected[i])));
  }
  EXPECT_GT(largest, 0) << layer << " is all zero: the test would prove nothing";
  EXPECT_LE(worst, kTensorTolerance * largest) << layer;
}

TEST_P(EngineGoldenTest, EveryLayerAndTheDepthAgreeWithLibTorch) {
  const GoldenCase& c = GetParam();
  const cv::Mat picture = real_picture(c.width, c.height);
  if (picture.empty()) GTEST_SKIP() << "the pictures of Debian's opencv-doc are not installed";
  const auto file = ModelFile::parse(test::make_random_model(test::make_config(c.encoder, c.preset),
                                                             /*seed=*/7));
  ASSERT_TRUE(file) << file.status().text();

  FoldedNet reference(*file);
  const at::Tensor image =
      torch::from_blob(picture.data, {1, c.height, c.width, 3}).permute({0, 3, 1, 2}).contiguous();
  reference.forward(image);

  const auto engine = prepare_engine(*file, c.width, c.height);
  ASSERT_NE(engine, nullptr);
  const std::span pixels(picture.ptr<float>(), picture.total() * 3);
  const auto depth = engine->run_network(pixels);
  ASSERT_TRUE(depth) << depth.status().text();

  for (const auto& [layer, want] : reference.outputs()) {
    const auto got = engine->tensor(layer);
    ASSERT_TRUE(got) << layer << ": " << got.status().text();
    expect_same(layer, *got, want);
  }
  const at::Tensor& want = reference.outputs().at("depth");
  double worst = 0;
  for (std::size_t i = 0; i < depth->size(); ++i) {
    const double expected = want.data_ptr<float>()[i];
    worst = test::worse(worst, std::abs((*depth)[i] - expected) / expected);
  }
  EXPECT_LE(worst, kDepthTolerance);
  RecordProperty("layers", static_cast<int>(reference.outputs().size()));
  std::printf("%zu layers; worst relative depth difference %.1e\n", reference.outputs().size(),
              worst);
}

// 640x480 has 15 rows at 1/32: the resize before and after the patches.
INSTANTIATE_TEST_SUITE_P(
    RealPictures, EngineGoldenTest,
    ::testing::Values(GoldenCase{EncoderKind::kXxs, PresetKind::kLcdm, 640, 192},
                      GoldenCase{EncoderKind::kXxs, PresetKind::kLcdm, 640, 480},
                      GoldenCase{EncoderKind::kXxs, PresetKind::kPaper, 640, 192},
                      GoldenCase{EncoderKind::kXxs, PresetKind::kPaper, 640, 480},
                      GoldenCase{EncoderKind::kXs, PresetKind::kLcdm, 640, 192},
                      GoldenCase{EncoderKind::kXs, PresetKind::kLcdm, 640, 480},
                      GoldenCase{EncoderKind::kXs, PresetKind::kPaper, 640, 192},
                      GoldenCase{EncoderKind::kXs, PresetKind::kPaper, 640, 480},
                      GoldenCase{EncoderKind::kS, PresetKind::kLcdm, 640, 192}),
    [](const auto& one) { return name_of(one.param); });

}  // namespace
}  // namespace lcdm::model
