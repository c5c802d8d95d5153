// The engine against what LibTorch computed once (tests/fixtures/golden): needs no LibTorch here.
#include <cmath>
#include <gtest/gtest.h>
#include <ostream>
#include <string>
#include <vector>

#include "firmware/nn/engine.h"
#include "tests/support/random_model.h"
#include "tests/support/worse.h"

namespace lcdm {
namespace {

constexpr double kTensorTolerance = 1e-4;  // of the layer's largest value
constexpr double kDepthTolerance = 1e-4;   // relative, every pixel

struct Fixture {
  const char* name;
  EncoderKind encoder;
  PresetKind preset;
  int width;
  int height;
};

void PrintTo(const Fixture& fixture, std::ostream* out) { *out << fixture.name; }

class GoldenTest : public ::testing::TestWithParam<Fixture> {};

std::vector<float> read(const ModelFile& file, const std::string& name) {
  const ModelFile::Tensor& tensor = file.tensors().at(name);
  std::vector<float> values(tensor.count);
  file.read(tensor, values);
  return values;
}

TEST_P(GoldenTest, TheEngineComputesWhatLibTorchComputed) {
  const Fixture& f = GetParam();
  const auto golden =
      ModelFile::load(std::string("tests/fixtures/golden/") + f.name + ".safetensors");
  ASSERT_TRUE(golden) << golden.status().text();
  const auto model = ModelFile::parse(
      test::make_random_model(test::make_config(f.encoder, f.preset), test::kGoldenSeed));
  ASSERT_TRUE(model) << model.status().text();

  EngineOptions options;
  options.width = f.width;
  options.height = f.height;
  options.keep_tensors = true;
  CameraModel camera = CameraModel::from_field_of_view(f.width, f.height, 65);
  camera.fx = static_cast<float>(model->config().canonical_focal);  // depth comes out canonical
  const auto engine = Engine::prepare(
      *model, options, {PixelFormat::kRgb24, f.width, f.height, f.width * 3}, camera);
  ASSERT_TRUE(engine) << engine.status().text();
  const auto depth = (*engine)->run_network(read(*golden, "input"));
  ASSERT_TRUE(depth) << depth.status().text();

  for (const auto& [layer, tensor] : golden->tensors()) {
    if (layer == "input" || layer == "depth") continue;
    const auto got = (*engine)->tensor(layer);
    ASSERT_TRUE(got) << got.status().text();
    const std::vector<float> want = read(*golden, layer);
    const std::size_t stride = (got->size() / 512) | 1;  // as lcdm-train golden has it
    ASSERT_EQ(want.size(), (got->size() + stride - 1) / stride) << layer;
    double worst = 0;
    double largest = 0;
    for (std::size_t i = 0; i < want.size(); ++i) {
      worst = test::worse(worst, std::fabs(static_cast<double>((*got)[i * stride]) - want[i]));
      largest = std::max(largest, std::fabs(static_cast<double>(want[i])));
    }
    EXPECT_LE(worst, kTensorTolerance * largest) << layer;
  }
  const std::vector<float> want = read(*golden, "depth");
  ASSERT_EQ(depth->size(), want.size());
  for (std::size_t i = 0; i < want.size(); ++i) {
    ASSERT_NEAR((*depth)[i], want[i], kDepthTolerance * static_cast<double>(want[i])) << "at " << i;
  }
}

INSTANTIATE_TEST_SUITE_P(
    Fixtures, GoldenTest,
    ::testing::Values(Fixture{"xxs-lcdm-96x64", EncoderKind::kXxs, PresetKind::kLcdm, 96, 64},
                      Fixture{"xs-lcdm-96x64", EncoderKind::kXs, PresetKind::kLcdm, 96, 64},
                      Fixture{"xxs-paper-64x96", EncoderKind::kXxs, PresetKind::kPaper, 64, 96}),
    [](const auto& fixture) {
      return std::string(to_string(fixture.param.encoder)) + "_" + to_string(fixture.param.preset);
    });

}  // namespace
}  // namespace lcdm
