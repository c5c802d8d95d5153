// Narrow products change the depth of pictures by no more than we say.
#include <cmath>
#include <gtest/gtest.h>
#include <ostream>
#include <string>
#include <vector>

#include "drivers/scene/render.h"
#include "firmware/nn/engine.h"

namespace lcdm {
namespace {

struct Guard {
  const char* model;  // a released one
  Precision precision;
  double mean_log_difference;  // to fp32, over all frames
  int camera_height = 480;     // of 640 pixels' width; 192: the wide input
};

std::string name_of(const Guard& guard) {
  return std::string(guard.model) + "_" + to_string(guard.precision) + "_" +
         std::to_string(guard.camera_height);
}
void PrintTo(const Guard& guard, std::ostream* out) { *out << name_of(guard); }

std::vector<std::uint8_t> picture_of(std::uint64_t seed, const CameraModel& camera) {
  std::vector<std::uint8_t> rgb(std::size_t{3} * camera.width * camera.height);
  scene::render(scene::Scene(seed), 1.0, camera, rgb, {});
  return rgb;
}

std::vector<float> depth_of(Engine& engine, const std::vector<std::uint8_t>& rgb) {
  const FrameFormat& format = engine.format();
  std::vector<std::uint16_t> millimetres(rgb.size() / 3);
  std::vector<float> metres(millimetres.size());
  const FrameView frame{format, {}, rgb.data(), rgb.size()};
  EXPECT_TRUE(engine.run(frame, {format.width, format.height, millimetres.data(), metres.data()}));
  return metres;
}

double log_difference(const std::vector<float>& a, const std::vector<float>& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    sum += std::fabs(std::log(static_cast<double>(a[i]) / static_cast<double>(b[i])));
  }
  return sum / static_cast<double>(a.size());
}

// With the head's convolution in bytes XXS has .0042, and one sees it.
constexpr double kMostGrain = 0.003;

// Mean difference between neighbours in a row of the difference: what one sees as grain.
double grain(const std::vector<float>& a, const std::vector<float>& b, int width) {
  double sum = 0;
  double left = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    const double here = std::log(static_cast<double>(a[i]) / static_cast<double>(b[i]));
    if (i % static_cast<std::size_t>(width) != 0) sum += std::fabs(here - left);
    left = here;
  }
  return sum / static_cast<double>(a.size());
}

class Precisions : public testing::TestWithParam<Guard> {};

TEST_P(Precisions, StayNearFloatWithTheReleasedWeights) {
  const Guard guard = GetParam();
  const Result<ModelFile> model =
      ModelFile::load(std::string("model/weights/lcdm-") + guard.model + ".safetensors");
  ASSERT_TRUE(model) << model.status().text();
  const NetworkSize size =
      choose_network_size(model->config(), {.width = 640, .height = guard.camera_height});
  const CameraModel camera = CameraModel::from_field_of_view(size.width, size.height, 65);
  const FrameFormat format = {PixelFormat::kRgb24, size.width, size.height, 3 * size.width};
  EngineOptions options{size.width, size.height, 2};
  const auto exact = Engine::prepare(*model, options, format, camera);
  options.precision = guard.precision;
  const auto narrow = Engine::prepare(*model, options, format, camera);
  ASSERT_TRUE(exact && narrow);
  if ((*narrow)->stats().precision != guard.precision) {
    GTEST_SKIP() << "this processor has no instructions for " << to_string(guard.precision);
  }
  constexpr std::uint64_t kScenes = 8;  // rooms and streets
  double sum = 0;
  double sum_of_grain = 0;
  for (std::uint64_t seed = 1; seed <= kScenes; ++seed) {
    const std::vector<std::uint8_t> rgb = picture_of(seed, camera);
    const std::vector<float> depth = depth_of(**narrow, rgb);
    const std::vector<float> exact_depth = depth_of(**exact, rgb);
    const double difference = log_difference(depth, exact_depth);
    EXPECT_GT(difference, 0) << "was it computed otherwise at all?";
    RecordProperty("scene" + std::to_string(seed), std::to_string(difference));
    sum += difference;
    sum_of_grain += grain(depth, exact_depth, size.width);
  }
  EXPECT_LE(sum / kScenes, guard.mean_log_difference);
  EXPECT_LE(sum_of_grain / kScenes, kMostGrain);
}

INSTANTIATE_TEST_SUITE_P(, Precisions,
                         testing::Values(Guard{"xxs", Precision::kFloat16, 0.005},
                                         Guard{"xxs", Precision::kBfloat16, 0.005},
                                         Guard{"xxs", Precision::kInt8, 0.015},
                                         Guard{"xs", Precision::kFloat16, 0.005},
                                         Guard{"xs", Precision::kBfloat16, 0.005},
                                         Guard{"xs", Precision::kInt8, 0.015},
                                         Guard{"xxs", Precision::kBfloat16, 0.005, 192},
                                         Guard{"xxs", Precision::kInt8, 0.015, 192},
                                         Guard{"xs", Precision::kBfloat16, 0.005, 192},
                                         Guard{"xs", Precision::kInt8, 0.015, 192}),
                         [](const auto& guard) { return name_of(guard.param); });

}  // namespace
}  // namespace lcdm
