// Narrow products change the depth of pictures by no more than we say.
#include <cmath>
#include <gtest/gtest.h>
#include <ostream>
#include <string>
#include <vector>

#include "drivers/scene_render.h"
#include "firmware/nn/engine.h"

namespace lcdm {
namespace {

constexpr int kWidth = 384;
constexpr int kHeight = 288;

struct Guard {
  const char* model;  // a released one
  Precision precision;
  double mean_log_difference;  // to fp32, over all frames
};

std::string name_of(const Guard& guard) {
  return std::string(guard.model) + "_" + to_string(guard.precision);
}
void PrintTo(const Guard& guard, std::ostream* out) { *out << name_of(guard); }

std::vector<std::uint8_t> picture_of(std::uint64_t seed, const CameraModel& camera) {
  std::vector<std::uint8_t> rgb(std::size_t{3} * kWidth * kHeight);
  scene::render(scene::Scene(seed), 1.0, camera, rgb, {});
  return rgb;
}

std::vector<float> depth_of(Engine& engine, const std::vector<std::uint8_t>& rgb) {
  std::vector<std::uint16_t> millimetres(std::size_t{1} * kWidth * kHeight);
  std::vector<float> metres(millimetres.size());
  const FrameView frame{engine.format(), {}, rgb.data(), rgb.size()};
  EXPECT_TRUE(engine.run(frame, {kWidth, kHeight, millimetres.data(), metres.data()}));
  return metres;
}

double log_difference(const std::vector<float>& a, const std::vector<float>& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    sum += std::fabs(std::log(static_cast<double>(a[i]) / static_cast<double>(b[i])));
  }
  return sum / static_cast<double>(a.size());
}

class Precisions : public testing::TestWithParam<Guard> {};

TEST_P(Precisions, StayNearFloatWithTheReleasedWeights) {
  const Guard guard = GetParam();
  const Result<ModelFile> model =
      ModelFile::load(std::string("model/weights/lcdm-") + guard.model + ".safetensors");
  ASSERT_TRUE(model) << model.status().text();
  const CameraModel camera = CameraModel::from_field_of_view(kWidth, kHeight, 65);
  const FrameFormat format = {PixelFormat::kRgb24, kWidth, kHeight, 3 * kWidth};
  EngineOptions options{kWidth, kHeight, 2};
  const auto exact = Engine::prepare(*model, options, format, camera);
  options.precision = guard.precision;
  const auto narrow = Engine::prepare(*model, options, format, camera);
  ASSERT_TRUE(exact && narrow);
  if ((*narrow)->stats().precision != guard.precision) {
    GTEST_SKIP() << "this processor has no instructions for " << to_string(guard.precision);
  }
  constexpr std::uint64_t kScenes = 8;  // rooms and streets
  double sum = 0;
  for (std::uint64_t seed = 1; seed <= kScenes; ++seed) {
    const std::vector<std::uint8_t> rgb = picture_of(seed, camera);
    const double difference = log_difference(depth_of(**narrow, rgb), depth_of(**exact, rgb));
    EXPECT_GT(difference, 0) << "was it computed otherwise at all?";
    RecordProperty("scene" + std::to_string(seed), std::to_string(difference));
    sum += difference;
  }
  EXPECT_LE(sum / kScenes, guard.mean_log_difference);
}

INSTANTIATE_TEST_SUITE_P(, Precisions,
                         testing::Values(Guard{"xxs", Precision::kFloat16, 0.005},
                                         Guard{"xxs", Precision::kBfloat16, 0.005},
                                         Guard{"xxs", Precision::kInt8, 0.015},
                                         Guard{"xs", Precision::kFloat16, 0.005},
                                         Guard{"xs", Precision::kBfloat16, 0.005},
                                         Guard{"xs", Precision::kInt8, 0.015}),
                         [](const auto& guard) { return name_of(guard.param); });

}  // namespace
}  // namespace lcdm
