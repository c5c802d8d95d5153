// The exported ONNX graph, computed by ONNX Runtime, beside the engine on the same model file.
#include "model/onnx_export.h"

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>
#include <vector>

#include "firmware/nn/engine.h"
#include "firmware/nn/noise.h"
#include "tests/support/random_model.h"
#include "tests/support/temporary_folder.h"
#include "tests/support/worse.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;

// 96x64 has three columns at 1/32: the resize before and after the patches is in the graph.
constexpr int kWidth = 96;
constexpr int kHeight = 64;
constexpr std::size_t kPixels = std::size_t{kWidth} * kHeight;

void write_floats(const fs::path& path, const std::vector<float>& values) {
  std::ofstream(path, std::ios::binary)
      .write(reinterpret_cast<const char*>(values.data()),
             static_cast<std::streamsize>(values.size() * sizeof(float)));
}

std::vector<float> read_floats(const fs::path& path) {
  std::vector<float> values(fs::file_size(path) / sizeof(float));
  std::ifstream(path, std::ios::binary)
      .read(reinterpret_cast<char*>(values.data()),
            static_cast<std::streamsize>(values.size() * sizeof(float)));
  return values;
}

class OnnxExport : public testing::TestWithParam<PresetKind> {};

TEST_P(OnnxExport, GivesTheEnginesDepthInOnnxRuntime) {
  if (!fs::exists("model/peers/node_modules/onnxruntime-node")) {
    GTEST_SKIP() << "no ONNX Runtime: npm --prefix model/peers install --ignore-scripts";
  }
  const test::TemporaryFolder scratch;
  const fs::path folder = scratch.path();
  ModelConfig config = test::make_config(EncoderKind::kXxs, GetParam());
  const auto file = ModelFile::parse(test::make_random_model(config, 7));
  ASSERT_TRUE(file) << file.status().text();
  const Status exported = export_onnx(*file, kWidth, kHeight, (folder / "model.onnx").string());
  ASSERT_TRUE(exported) << exported.text();

  std::vector<float> nhwc(kPixels * 3);
  fill_gaussian(3, nhwc);
  std::vector<float> nchw(nhwc.size());
  for (std::size_t i = 0; i < nhwc.size(); ++i) nchw[i % 3 * kPixels + i / 3] = nhwc[i];
  write_floats(folder / "image.f32", nchw);
  const std::string command =
      "node model/peers/onnxruntime.mjs " + (folder / "model.onnx").string() + " " +
      (folder / "image.f32").string() + " " + (folder / "depth.f32").string();
  ASSERT_EQ(std::system(command.c_str()), 0);
  const std::vector<float> theirs = read_floats(folder / "depth.f32");

  EngineOptions options;
  options.width = kWidth;
  options.height = kHeight;
  CameraModel camera = CameraModel::from_field_of_view(kWidth, kHeight, 65);
  camera.fx = static_cast<float>(config.canonical_focal);  // depth comes out canonical
  const auto engine =
      Engine::prepare(*file, options, {PixelFormat::kRgb24, kWidth, kHeight, kWidth * 3}, camera);
  ASSERT_TRUE(engine) << engine.status().text();
  const auto ours = (*engine)->run_network(nhwc);
  ASSERT_TRUE(ours) << ours.status().text();
  ASSERT_EQ(ours->size(), theirs.size());
  double worst = 0;
  for (std::size_t i = 0; i < theirs.size(); ++i) {
    worst = test::worse(worst, std::abs(static_cast<double>((*ours)[i]) - theirs[i]) / theirs[i]);
  }
  EXPECT_LE(worst, 1e-4);
  std::printf("worst relative depth difference %.1e\n", worst);
}

INSTANTIATE_TEST_SUITE_P(Presets, OnnxExport,
                         testing::Values(PresetKind::kLcdm, PresetKind::kPaper),
                         [](const auto& preset) { return std::string(to_string(preset.param)); });

TEST(OnnxExportSize, RefusesASizeTheNetworkCannotHave) {
  const auto file = ModelFile::parse(
      test::make_random_model(test::make_config(EncoderKind::kXxs, PresetKind::kLcdm), 7));
  ASSERT_TRUE(file);
  EXPECT_EQ(export_onnx(*file, 100, 64, "/dev/null").code(), StatusCode::kInvalidInput);
}

}  // namespace
}  // namespace lcdm::model
