// The engine against the same network in plain double-precision loops, layer by layer.
#include <algorithm>
#include <array>
#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <ostream>
#include <vector>

#include "firmware/nn/engine.h"
#include "firmware/nn/noise.h"
#include "tests/support/random_model.h"
#include "tests/support/reference_network.h"

namespace lcdm {
namespace {

struct Case {
  EncoderKind encoder;
  PresetKind preset;
  int width;
  int height;
  std::array<int, 5> decoder_widths = {8, 16, 32, 64, 128};
  int condition_channels = 16;
  std::vector<int> steps = {};  // empty: the preset's
  StartKind start = StartKind::kNoise;
  double variable_mean = 0;
  double variable_std = 1;
};

Case from_zeros(Case c, double mean, double deviation) {
  c.start = StartKind::kZeros;
  c.variable_mean = mean;
  c.variable_std = deviation;
  return c;
}

// Largest |engine - reference| over largest |reference|, or by itself where all of that is zero;
// the engine's tensor is channels-last.
double relative_difference(std::span<const float> engine, const test::Planes& reference) {
  double largest = 0;
  double difference = 0;
  for (int y = 0; y < reference.height; ++y) {
    for (int x = 0; x < reference.width; ++x) {
      for (int c = 0; c < reference.channels; ++c) {
        const int i = (y * reference.width + x) * reference.channels + c;
        const double expected = reference.at(c, y, x);
        const auto actual = static_cast<double>(engine[static_cast<std::size_t>(i)]);
        if (!std::isfinite(actual)) return std::numeric_limits<double>::infinity();
        largest = std::max(largest, std::fabs(expected));
        difference = std::max(difference, std::fabs(actual - expected));
      }
    }
  }
  return largest > 0 ? difference / largest : difference;
}

std::string name_of(const Case& c) {
  return std::string(to_string(c.encoder)) + "_" + to_string(c.preset) + "_" +
         std::to_string(c.width) + "x" + std::to_string(c.height) + "_" +
         std::to_string(c.condition_channels) + "channels" +
         (c.start == StartKind::kZeros ? "_zeros" : "");
}

void PrintTo(const Case& c, std::ostream* out) { *out << name_of(c); }

class EngineReference : public testing::TestWithParam<Case> {};

TEST_P(EngineReference, EveryLayerAgrees) {
  const Case& c = GetParam();
  ModelConfig config = test::make_config(c.encoder, c.preset);
  config.decoder_widths = c.decoder_widths;
  config.condition_channels = c.condition_channels;
  if (!c.steps.empty()) config.steps = c.steps;
  config.start = c.start;
  config.variable_mean = c.variable_mean;
  config.variable_std = c.variable_std;
  const auto weights = test::make_random_weights(config, 7);
  const auto model = ModelFile::parse(test::make_model_image(test::metadata_json(config), weights));
  ASSERT_TRUE(model) << model.status().text();

  CameraModel camera = CameraModel::from_field_of_view(c.width, c.height, 60);
  camera.fx = static_cast<float>(config.canonical_focal);  // depth is then canonical depth
  const FrameFormat format = {PixelFormat::kRgb24, c.width, c.height, c.width * 3};
  const auto engine =
      Engine::prepare(*model, {c.width, c.height, 2, /*keep_tensors=*/true}, format, camera);
  ASSERT_TRUE(engine) << engine.status().text();

  std::vector<float> rgb(static_cast<std::size_t>(c.width * c.height * 3));
  fill_gaussian(3, rgb);
  const auto depth = (*engine)->run_network(rgb);
  ASSERT_TRUE(depth) << depth.status().text();
  const auto reference = test::run_reference(config, weights, rgb, c.width, c.height);

  ASSERT_EQ(reference.size(), (*engine)->network().layers().size());
  for (const Layer& layer : (*engine)->network().layers()) {
    const auto tensor = (*engine)->tensor(layer.name);
    ASSERT_TRUE(tensor) << tensor.status().text();
    const auto expected = reference.find(layer.name);
    ASSERT_NE(expected, reference.end()) << layer.name;
    ASSERT_EQ(tensor->size(), expected->second.values.size()) << layer.name;
    EXPECT_LE(relative_difference(*tensor, expected->second), 1e-4) << layer.name;
  }
  const test::Planes& metres = reference.at("depth");
  for (std::size_t i = 0; i < depth->size(); ++i) {
    ASSERT_NEAR(static_cast<double>((*depth)[i]) / metres.values[i], 1, 1e-4) << i;
  }
}

// 96x32-multiples give odd sides at 1/32, 1/16 and 1/8: the resize path. Odd widths fill no vector.
// A start of zeros, as the released models have it, has a way of its own through the first step:
// one row for the hidden layer inside the update, one for the hidden layer that a norm follows.
INSTANTIATE_TEST_SUITE_P(
    Networks, EngineReference,
    testing::Values(
        Case{EncoderKind::kXxs, PresetKind::kLcdm, 64, 64},
        Case{EncoderKind::kXxs, PresetKind::kPaper, 64, 64},
        Case{EncoderKind::kXxs, PresetKind::kLcdm, 96, 64},
        Case{EncoderKind::kXxs, PresetKind::kPaper, 64, 96},
        Case{EncoderKind::kXs, PresetKind::kLcdm, 96, 96},
        Case{EncoderKind::kS, PresetKind::kLcdm, 64, 64},
        Case{EncoderKind::kXxs, PresetKind::kLcdm, 64, 64, {3, 17, 5, 64, 9}, 4, {149}},
        Case{EncoderKind::kXxs, PresetKind::kPaper, 64, 64, {16, 7, 33, 20, 50}, 20, {140, 75, 0}},
        Case{EncoderKind::kXxs, PresetKind::kLcdm, 64, 64, {16, 7, 33, 20, 50}, 20, {140, 75, 0}},
        from_zeros({EncoderKind::kXxs, PresetKind::kLcdm, 96, 64}, -4.0161, 1.6534),
        from_zeros(
            {EncoderKind::kXxs, PresetKind::kPaper, 64, 64, {16, 7, 33, 20, 50}, 20, {140, 75, 0}},
            1.37, 0.61)),
    [](const auto& of) { return name_of(of.param); });

}  // namespace
}  // namespace lcdm
