// The engine as the pipeline uses it: frames in, depth out, the same bytes, no allocation.
#include "firmware/nn/engine.h"

#include <algorithm>
#include <cmath>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware/base/alloc_watch.h"
#include "firmware/base/os.h"
#include "firmware/vision/lens_map.h"
#include "tests/support/locked_memory_limit.h"
#include "tests/support/random_model.h"

namespace lcdm {
namespace {

using testing::HasSubstr;

ModelFile make_model(EncoderKind encoder = EncoderKind::kXxs,
                     PresetKind preset = PresetKind::kLcdm) {
  auto model = ModelFile::parse(test::make_random_model(test::make_config(encoder, preset), 5));
  EXPECT_TRUE(model) << model.status().text();
  return std::move(*model);
}

constexpr FrameFormat kFormat = {PixelFormat::kRgb24, 150, 110, 460};
const CameraModel kCamera = CameraModel::from_field_of_view(150, 110, 70);

// A frame with its bytes, and room for the depth made from it.
struct Bench {
  std::vector<std::uint8_t> bytes;
  std::vector<std::uint16_t> millimetres;
  std::vector<float> metres;
  FrameView frame;

  explicit Bench(const FrameFormat& format = kFormat)
      : bytes(static_cast<std::size_t>(format.stride * format.height)) {
    for (std::size_t i = 0; i < bytes.size(); ++i) {
      bytes[i] = static_cast<std::uint8_t>((i * 2654435761U) >> 24);
    }
    frame.format = format;
    frame.data = bytes.data();
    frame.bytes = bytes.size();
  }
  Status run(Engine& engine) {
    const EngineStats stats = engine.stats();
    const int area = stats.width * stats.height;
    const auto pixels = static_cast<std::size_t>(area);
    millimetres.assign(pixels, 7);
    metres.assign(pixels, 0);
    return engine.run(frame, {stats.width, stats.height, millimetres.data(), metres.data()});
  }
};

std::unique_ptr<Engine> prepare(const ModelFile& model, const EngineOptions& options,
                                const FrameFormat& format = kFormat) {
  auto engine = Engine::prepare(model, options, format, kCamera);
  EXPECT_TRUE(engine) << engine.status().text();
  return std::move(*engine);
}

void expect_same_bytes(const ModelFile& model, Precision precision) {
  SCOPED_TRACE(to_string(precision));
  Bench first;
  ASSERT_TRUE(first.run(*prepare(model, {160, 96, 1, false, precision})));
  for (const int threads : {1, 2, 3, 5}) {
    const auto engine = prepare(model, {160, 96, threads, false, precision});
    for (int round = 0; round < 3; ++round) {
      Bench bench;
      ASSERT_TRUE(bench.run(*engine));
      ASSERT_EQ(bench.metres, first.metres) << threads << " threads, round " << round;
      ASSERT_EQ(bench.millimetres, first.millimetres);
    }
  }
}

TEST(Engine, GivesTheSameBytesOnEveryRunAndForAnyNumberOfThreads) {
  for (const auto preset : {PresetKind::kLcdm, PresetKind::kPaper}) {
    const ModelFile model = make_model(EncoderKind::kXxs, preset);
    for (const Precision precision : kPrecisions) expect_same_bytes(model, precision);
  }
}

TEST(Engine, KeepingTensorsChangesNothing) {
  const ModelFile model = make_model();
  for (const Precision precision : kPrecisions) {
    Bench lean;
    Bench keeping;
    ASSERT_TRUE(lean.run(*prepare(model, {96, 64, 1, false, precision})));
    ASSERT_TRUE(keeping.run(*prepare(model, {96, 64, 1, true, precision})));
    EXPECT_EQ(lean.metres, keeping.metres) << to_string(precision);
  }
}

TEST(Engine, OutlivesItsModelFile) {
  std::unique_ptr<Engine> engine;
  Bench reference;
  {
    auto model = std::make_unique<ModelFile>(make_model());
    engine = prepare(*model, {64, 64});
    ASSERT_TRUE(reference.run(*prepare(*model, {64, 64})));
  }
  Bench bench;
  ASSERT_TRUE(bench.run(*engine));
  EXPECT_EQ(bench.metres, reference.metres);
}

void expect_no_allocation(const ModelFile& model, Precision precision) {
  const auto engine = prepare(model, {96, 96, 2, false, precision});
  Bench bench;
  ASSERT_TRUE(bench.run(*engine));  // makes the buffers
  const EngineStats stats = engine->stats();
  const DepthBuffer out = {stats.width, stats.height, bench.millimetres.data(), nullptr};
  FrameView broken = bench.frame;
  broken.bytes = 10;
  const std::uint64_t before = alloc_watch::sealed_allocations();
  alloc_watch::seal_thread();
  for (int i = 0; i < 20; ++i) {
    const bool fine = engine->run(bench.frame, out).is_ok();
    const bool refused = !engine->run(broken, out).is_ok();
    LCDM_CHECK(fine && refused);
  }
  alloc_watch::unseal_thread();
  EXPECT_EQ(alloc_watch::sealed_allocations() - before, 0U);
}

TEST(Engine, AllocatesNothingWhileItRuns) {
  if (!alloc_watch::hooked()) GTEST_SKIP() << "allocations are not watched under sanitizers";
  for (const auto preset : {PresetKind::kLcdm, PresetKind::kPaper}) {
    const ModelFile model = make_model(EncoderKind::kXxs, preset);
    for (const Precision precision : kPrecisions) expect_no_allocation(model, precision);
  }
}

TEST(Engine, TouchesNoNewPageWhileItRuns) {
  if (!alloc_watch::hooked()) GTEST_SKIP() << "sanitizers have pages of their own";
  for (const auto preset : {PresetKind::kLcdm, PresetKind::kPaper}) {
    const auto engine = prepare(make_model(EncoderKind::kXxs, preset), {96, 96, 2});
    Bench bench;
    for (int i = 0; i < 3; ++i) ASSERT_TRUE(bench.run(*engine));
    const DepthBuffer out = {96, 96, bench.millimetres.data(), nullptr};
    // The kernel takes pages away at times; what the engine touched anew would show every time.
    std::int64_t fewest = 1;
    for (int round = 0; round < 10 && fewest > 0; ++round) {
      const std::int64_t before = os::page_faults();
      for (int i = 0; i < 5; ++i) ASSERT_TRUE(engine->run(bench.frame, out));
      fewest = std::min(fewest, os::page_faults() - before);
    }
    EXPECT_EQ(fewest, 0) << to_string(preset);
  }
}

TEST(Engine, DepthFollowsTheFocalLengthOfTheCamera) {
  const ModelFile model = make_model();
  CameraModel tele = kCamera;
  tele.fx *= 2;
  Bench wide_bench;
  Bench tele_bench;
  ASSERT_TRUE(wide_bench.run(*prepare(model, {64, 64})));
  const auto engine = Engine::prepare(model, {64, 64}, kFormat, tele);
  ASSERT_TRUE(engine);
  ASSERT_TRUE(tele_bench.run(**engine));
  for (std::size_t i = 0; i < wide_bench.metres.size(); ++i) {
    ASSERT_FLOAT_EQ(tele_bench.metres[i], 2 * wide_bench.metres[i]);
  }
  EXPECT_FLOAT_EQ((*engine)->depth_camera().fx, tele.fx * 64 / 150);
  EXPECT_EQ((*engine)->depth_camera().width, 64);
}

TEST(Engine, ShowsAPinholesViewOfADistortedPictureAndSaysWhich) {
  CameraModel lens = kCamera;
  lens.distortion = {-0.2F, 0.03F};
  const ModelFile model = make_model();
  const auto engine = Engine::prepare(model, {64, 64}, kFormat, lens);
  ASSERT_TRUE(engine) << engine.status().text();
  EXPECT_FALSE((*engine)->depth_camera().distorted());
  EXPECT_EQ((*engine)->depth_camera(), *pinhole_view(lens, 64, 64));
  EXPECT_GT((*engine)->stats().preprocess_bytes,
            prepare(model, {64, 64})->stats().preprocess_bytes);
  Bench bench;
  Bench straight;
  ASSERT_TRUE(bench.run(**engine));
  ASSERT_TRUE(straight.run(*prepare(model, {64, 64})));
  EXPECT_NE(bench.metres, straight.metres);

  lens.distortion[0] = -9;
  EXPECT_THAT(Engine::prepare(model, {64, 64}, kFormat, lens).status().text(), HasSubstr("folds"));
  lens.distortion[0] = -0.2F;
  lens.width = 300;
  EXPECT_THAT(Engine::prepare(model, {64, 64}, kFormat, lens).status().text(),
              HasSubstr("300x110"));
}

TEST(Engine, TheOutermostSevenPixelsRepeatThoseInside) {
  const auto engine = prepare(make_model(), {96, 64, 1, true});
  Bench bench;
  ASSERT_TRUE(bench.run(*engine));
  const auto computed = engine->tensor("depth");
  ASSERT_TRUE(computed) << computed.status().text();
  for (int y = 0; y < 64; ++y) {
    for (int x = 0; x < 96; ++x) {
      const int inside = std::clamp(y, 7, 56) * 96 + std::clamp(x, 7, 88);
      const int here = y * 96 + x;
      ASSERT_EQ(bench.metres[here], (*computed)[inside]) << x << ", " << y;
      ASSERT_EQ(bench.millimetres[here], bench.millimetres[inside]);
    }
  }
}

TEST(Engine, MillimetresAreTheMetresRounded) {
  Bench bench;
  ASSERT_TRUE(bench.run(*prepare(make_model(), {64, 64})));
  for (std::size_t i = 0; i < bench.metres.size(); ++i) {
    ASSERT_NEAR(bench.millimetres[i], std::min(bench.metres[i] * 1000, 65535.0F), 0.51);
  }
}

TEST(Engine, TakesEveryPixelFormatOfTheSamePictureAlike) {
  const ModelFile model = make_model();
  const FrameFormat rgb = {PixelFormat::kRgb24, 128, 96, 128 * 3};
  const FrameFormat bgr = {PixelFormat::kBgr24, 128, 96, 128 * 3};
  const FrameFormat yuyv = {PixelFormat::kYuyv, 128, 96, 128 * 2};
  Bench in_rgb(rgb);
  Bench in_bgr(bgr);
  Bench in_yuyv(yuyv);
  // A grey picture, so that all three can express it: luma 16 + 219 * grey / 255.
  for (std::size_t i = 0; i < std::size_t{128} * 96; ++i) {
    const auto luma = static_cast<std::uint8_t>(16 + i % 220);
    const auto grey = static_cast<std::uint8_t>(std::lround((luma - 16) * 255.0 / 219));
    for (std::size_t c = 0; c < 3; ++c) {
      in_rgb.bytes[i * 3 + c] = in_bgr.bytes[i * 3 + c] = grey;
    }
    in_yuyv.bytes[i * 2] = luma;
    in_yuyv.bytes[i * 2 + 1] = 128;
  }
  ASSERT_TRUE(in_rgb.run(*prepare(model, {64, 64}, rgb)));
  ASSERT_TRUE(in_bgr.run(*prepare(model, {64, 64}, bgr)));
  ASSERT_TRUE(in_yuyv.run(*prepare(model, {64, 64}, yuyv)));
  EXPECT_EQ(in_rgb.metres, in_bgr.metres);
  for (std::size_t i = 0; i < in_rgb.metres.size(); ++i) {
    ASSERT_NEAR(in_yuyv.metres[i] / in_rgb.metres[i], 1, 0.05) << i;
  }
}

TEST(Engine, RefusesAFrameItWasNotPreparedForAndLeavesTheDepthAlone) {
  const auto engine = prepare(make_model(), {64, 64});
  const auto expect_refused = [&](auto&& change, const char* reason) {
    Bench bench;
    change(bench);
    const Status status = bench.run(*engine);
    EXPECT_EQ(status.code(), StatusCode::kInvalidInput);
    EXPECT_THAT(status.text(), HasSubstr(reason));
    EXPECT_THAT(bench.millimetres, testing::Each(7));
  };
  expect_refused([](Bench& b) { b.frame.bytes = 450; }, "bytes");
  expect_refused([](Bench& b) { b.frame.data = nullptr; }, "bytes");
  expect_refused([](Bench& b) { b.frame.format.width = 149; }, "prepared for");
  expect_refused([](Bench& b) { b.frame.format.pixel = PixelFormat::kBgr24; }, "prepared for");
  expect_refused([](Bench& b) { b.frame.format.stride = 450; }, "prepared for");
  Bench bench;
  std::vector<std::uint16_t> small(10);
  EXPECT_THAT(engine->run(bench.frame, {5, 2, small.data(), nullptr}).text(), HasSubstr("64x64"));
  EXPECT_FALSE(engine->run(bench.frame, {64, 64, nullptr, nullptr}));
}

TEST(Engine, LastRowMayLackItsPadding) {
  const auto engine = prepare(make_model(), {64, 64});
  Bench bench;
  bench.frame.bytes -= 460 - 450;
  EXPECT_TRUE(bench.run(*engine));
}

// Each of its channels is within the limit; a board would be out of memory before the first frame.
TEST(Engine, RefusesAModelThatNeedsMoreMemoryThanABoardHas) {
  ModelConfig config = test::make_config(EncoderKind::kXxs, PresetKind::kPaper);
  config.decoder_widths.fill(ModelConfig::kMaxChannels);
  config.condition_channels = ModelConfig::kMaxChannels;
  const auto model = ModelFile::parse(test::make_random_model(config, 1));
  ASSERT_TRUE(model) << model.status().text();
  const auto engine = Engine::prepare(*model, {1024, 1024}, kFormat, kCamera);
  EXPECT_EQ(engine.code(), StatusCode::kInvalidInput);
  EXPECT_THAT(engine.status().text(), HasSubstr("at most 512 are given"));
}

TEST(Engine, CountsWhatEachThreadNeedsAgainstThatLimit) {
  const ModelFile model = make_model();
  const auto engine = Engine::prepare(model, {2048, 1600, 64}, kFormat, kCamera);
  EXPECT_EQ(engine.code(), StatusCode::kInvalidInput);
  EXPECT_THAT(engine.status().text(),
              AllOf(HasSubstr("layers 2"), HasSubstr("at most 512"), HasSubstr("model.threads")));
  EXPECT_LT(prepare(model, {2048, 1600, 1})->stats().arena_bytes, std::size_t{512} << 20);
}

TEST(Engine, PrepareSaysWhatCannotBeUsed) {
  const ModelFile model = make_model();
  const auto refusal = [&](const EngineOptions& options, const FrameFormat& format,
                           const CameraModel& camera) {
    const auto engine = Engine::prepare(model, options, format, camera);
    return std::string(engine ? "accepted" : engine.status().text());
  };
  EXPECT_THAT(refusal({640, 0}, kFormat, kCamera), HasSubstr("both sides"));
  EXPECT_THAT(refusal({65, 64}, kFormat, kCamera), HasSubstr("multiples of 32"));
  EXPECT_THAT(refusal({-64, 640}, kFormat, kCamera), HasSubstr("multiples of 32"));
  EXPECT_THAT(refusal({64, 64, 0}, kFormat, kCamera), HasSubstr("threads"));
  EXPECT_THAT(refusal({64, 64, 1000}, kFormat, kCamera), HasSubstr("threads"));
  EXPECT_THAT(refusal({64, 64}, {PixelFormat::kMjpeg, 150, 110, 0}, kCamera), HasSubstr("MJPEG"));
  EXPECT_THAT(refusal({64, 64}, {PixelFormat::kRgb24, 150, 110, 449}, kCamera),
              HasSubstr("stride"));
  EXPECT_THAT(refusal({64, 64}, {PixelFormat::kRgb24, 0, 110, 450}, kCamera),
              HasSubstr("not possible"));
  EXPECT_THAT(refusal({64, 64}, kFormat, CameraModel{}), HasSubstr("camera model"));
}

TEST(Engine, StatsDescribeWhatRuns) {
  const ModelFile model = make_model();
  const auto engine = prepare(model, {96, 64, 2});
  const EngineStats stats = engine->stats();
  EXPECT_EQ(stats.width, 96);
  EXPECT_EQ(stats.height, 64);
  EXPECT_EQ(stats.threads, 2);
  EXPECT_EQ(stats.model_name, "random-xxs-lcdm");
  EXPECT_EQ(stats.model_licence, "Apache-2.0");
  EXPECT_EQ(stats.model_hash, model.hash());
  EXPECT_EQ(stats.macs, engine->network().macs());
  EXPECT_GT(stats.arena_bytes, 0U);
  EXPECT_GT(stats.weight_bytes, 1'700'000U * 4);  // 1.73 M parameters
}

TEST(Engine, TensorsAreReadByNameOnlyWhenKept) {
  const ModelFile model = make_model();
  const auto keeping = prepare(model, {64, 64, 1, true});
  EXPECT_EQ(keeping->tensor("decoder.condition")->size(), 64U * 64 * 16);
  EXPECT_EQ(keeping->tensor("nonsense").code(), StatusCode::kNotFound);
  EXPECT_EQ(prepare(model, {64, 64})->tensor("depth").code(), StatusCode::kInvalidInput);
  EXPECT_EQ(keeping->run_network(std::vector<float>(3)).code(), StatusCode::kInvalidInput);
}

#ifndef LCDM_SANITIZED  // there nothing is locked
// What the service's warning and the status say by.
TEST(EngineDeathTest, SaysThatItsMemoryIsNotLockedWhereTheLimitIsTooSmall) {
  const ModelFile model = make_model();
  const auto prepare_within_limit = [&] {
    test::limit_locked_memory(rlim_t{1} << 20);
    _exit(prepare(model, {64, 64})->stats().memory_locked ? 1 : 0);
  };
  EXPECT_EXIT(prepare_within_limit(), testing::ExitedWithCode(0), "");
}
#endif

TEST(NetworkSize, FollowsTheShapeOfTheCamera) {
  ModelConfig model;
  model.trained_sizes = {{640, 192}, {384, 288}};
  const auto chosen = [&](int width, int height) {
    const NetworkSize size =
        choose_network_size(model, CameraModel::from_field_of_view(width, height, 60));
    return std::pair(size.width, size.height);
  };
  EXPECT_EQ(chosen(1242, 375), std::pair(640, 192));
  EXPECT_EQ(chosen(1226, 370), std::pair(640, 192));
  EXPECT_EQ(chosen(640, 480), std::pair(384, 288));
  EXPECT_EQ(chosen(320, 240), std::pair(384, 288));
  EXPECT_EQ(chosen(480, 640), std::pair(288, 384));
  EXPECT_EQ(chosen(1280, 720), std::pair(448, 256));
  EXPECT_EQ(chosen(500, 500), std::pair(320, 320));

  model.trained_sizes[1] = {256, 192};
  EXPECT_EQ(chosen(1242, 375), std::pair(640, 192));
  EXPECT_EQ(chosen(640, 480), std::pair(256, 192));
  EXPECT_EQ(chosen(480, 640), std::pair(192, 256));
  EXPECT_EQ(chosen(1280, 720), std::pair(288, 160));
}

TEST(NetworkSize, IsAlwaysOneTheNetworkAccepts) {
  ModelConfig config = test::make_config(EncoderKind::kXxs, PresetKind::kLcdm);
  for (const auto& trained : {std::array{640, 192}, {1, 1}, {4096, 256}}) {
    config.trained_sizes = {trained};
    for (const auto& [width, height] : {std::pair(1, 8000), std::pair(8000, 1), std::pair(1, 1)}) {
      const NetworkSize size =
          choose_network_size(config, CameraModel::from_field_of_view(width, height, 60));
      EXPECT_TRUE(Network::build(config, size.width, size.height)) << width << "x" << height;
    }
  }
}

// A file may hold any finite weights: its frames are depth or none, and nothing worse happens.
TEST(Engine, SurvivesWeightsOfAnySize) {
  const ModelConfig config = test::make_config(EncoderKind::kXxs, PresetKind::kLcdm);
  const std::vector<test::RandomTensor> weights = test::make_random_weights(config, 5);
  for (std::size_t i = 0; i < weights.size(); i += 19) {
    std::vector<test::RandomTensor> huge = weights;
    for (float& value : huge[i].values) value *= 1e30F;
    const auto model = ModelFile::parse(test::make_model_image(test::metadata_json(config), huge));
    ASSERT_TRUE(model) << model.status().text();
    for (const Precision precision : {Precision::kFloat32, Precision::kInt8}) {
      EngineOptions options{64, 64, 1};
      options.precision = precision;
      const auto engine = prepare(*model, options);
      Bench bench;
      EXPECT_TRUE(bench.run(*engine)) << weights[i].name;
      for (std::size_t p = 0; p < bench.metres.size(); ++p) {
        const float metres = bench.metres[p];
        ASSERT_EQ(bench.millimetres[p] == 0, !(metres > 0)) << weights[i].name << " at " << p;
      }
    }
  }
}

}  // namespace
}  // namespace lcdm
