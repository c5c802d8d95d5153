// The layer list, the weights it asks for, and the memory it needs.
#include "firmware/nn/network.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <map>

#include "firmware/base/os.h"
#include "firmware/nn/kernels/matrix.h"
#include "firmware/nn/network_plan.h"
#include "firmware/nn/program.h"
#include "tests/support/random_model.h"

namespace lcdm {
namespace {

using testing::HasSubstr;

Network make_network(EncoderKind encoder, PresetKind preset, int width, int height) {
  auto network = Network::build(test::make_config(encoder, preset), width, height);
  EXPECT_TRUE(network) << network.status().text();
  return std::move(*network);
}

Shape shape_of(const Network& network, const char* name) {
  const int index = network.find(name);
  EXPECT_GE(index, 0) << name;
  return network.layer(index).output;
}

ModelFile model_of(const std::vector<test::RandomTensor>& tensors, const ModelConfig& config) {
  auto model = ModelFile::parse(test::make_model_image(test::metadata_json(config), tensors));
  EXPECT_TRUE(model) << model.status().text();
  return std::move(*model);
}

// The list of tests/support/random_model was written from NETWORK.md on its own.
TEST(Network, AsksForExactlyTheTensorsOfTheSpecification) {
  for (const auto encoder : {EncoderKind::kXxs, EncoderKind::kXs, EncoderKind::kS}) {
    for (const auto preset : {PresetKind::kLcdm, PresetKind::kPaper}) {
      const ModelConfig config = test::make_config(encoder, preset);
      const auto weights = test::make_random_weights(config, 1);
      const Status checked =
          make_network(encoder, preset, 64, 64).check_weights(model_of(weights, config));
      EXPECT_TRUE(checked) << checked.text();
    }
  }
}

TEST(Network, NamesTheTensorThatIsMissingMisshapenOrExtra) {
  const ModelConfig config = test::make_config(EncoderKind::kXxs, PresetKind::kLcdm);
  const Network network = make_network(EncoderKind::kXxs, PresetKind::kLcdm, 64, 64);
  const auto weights = test::make_random_weights(config, 1);

  auto missing = weights;
  missing.pop_back();
  EXPECT_STREQ(network.check_weights(model_of(missing, config)).text(),
               "model: tensor `head.conv2.bias` [1] is missing: export the model again");

  auto misshapen = weights;
  misshapen[0].shape = {16, 27};
  EXPECT_STREQ(network.check_weights(model_of(misshapen, config)).text(),
               "model: tensor `encoder.stem.weight` is [16, 27], expected [16, 3, 3, 3]: export "
               "the model again");

  auto extra = weights;
  extra.push_back({"encoder.fc.weight", {2}, {1, 2}});
  EXPECT_STREQ(network.check_weights(model_of(extra, config)).text(),
               "model: tensor `encoder.fc.weight` [2] is not part of this network: export the "
               "model again");
}

TEST(Network, HasTheShapesOfTheSpecification) {
  const Network network = make_network(EncoderKind::kXs, PresetKind::kLcdm, 640, 192);
  EXPECT_EQ(shape_of(network, "encoder.stem"), (Shape{96, 320, 16}));
  EXPECT_EQ(shape_of(network, "encoder.stages.0.0.conv1_1x1"), (Shape{96, 320, 64}));
  EXPECT_EQ(shape_of(network, "encoder.stages.0.0.conv3_1x1"), (Shape{96, 320, 32}));
  EXPECT_EQ(shape_of(network, "encoder.stages.1.2.conv3_1x1"), (Shape{48, 160, 48}));
  EXPECT_EQ(shape_of(network, "encoder.stages.2.1.unfold"), (Shape{4, 480, 96}));
  EXPECT_EQ(shape_of(network, "encoder.stages.3.1.conv_fusion"), (Shape{12, 40, 80}));
  EXPECT_EQ(shape_of(network, "encoder.final_conv"), (Shape{6, 20, 384}));
  EXPECT_EQ(shape_of(network, "decoder.upconv_4_1"), (Shape{12, 40, 128}));
  EXPECT_EQ(shape_of(network, "decoder.upconv_0_0"), (Shape{96, 320, 8}));
  EXPECT_EQ(shape_of(network, "decoder.condition"), (Shape{192, 640, 16}));
  EXPECT_EQ(shape_of(network, "depth"), (Shape{192, 640, 1}));
  EXPECT_EQ(network.layers().front().name, "input");
  EXPECT_EQ(network.layers().back().name, "depth");
}

TEST(Network, ResizesOnlyWhereASideIsOdd) {
  EXPECT_EQ(make_network(EncoderKind::kXs, PresetKind::kLcdm, 640, 192)
                .find("encoder.stages.4.1.resize_up"),
            -1);
  const Network odd = make_network(EncoderKind::kXs, PresetKind::kLcdm, 640, 480);
  EXPECT_EQ(shape_of(odd, "encoder.stages.4.1.resize_up"), (Shape{16, 20, 144}));
  EXPECT_EQ(shape_of(odd, "encoder.stages.4.1.resize_back"), (Shape{15, 20, 144}));
  EXPECT_EQ(odd.find("encoder.stages.3.1.resize_up"), -1);
}

TEST(Network, RefusesSizesItCannotRun) {
  const ModelConfig config = test::make_config(EncoderKind::kXs, PresetKind::kLcdm);
  for (const auto& [width, height] :
       std::map<int, int>{{0, 192}, {32, 192}, {640, -32}, {641, 192}, {624, 192}, {4096, 192}}) {
    const auto network = Network::build(config, width, height);
    EXPECT_EQ(network.code(), StatusCode::kInvalidInput) << width << "x" << height;
    EXPECT_THAT(network.status().text(), HasSubstr("multiples of 32"));
  }
}

// Figures of the paper's size, in multiply-adds with attention: S 5.86 G, XS 3.81 G, XXS 2.42 G.
TEST(Network, CountsItsOperations) {
  const auto giga = [](EncoderKind encoder, int width, int height) {
    const auto macs = make_network(encoder, PresetKind::kLcdm, width, height).macs();
    return static_cast<double>(macs) * 1e-9;
  };
  EXPECT_NEAR(giga(EncoderKind::kXxs, 640, 192), 2.42, 0.01);
  EXPECT_NEAR(giga(EncoderKind::kXs, 640, 192), 3.81, 0.01);
  EXPECT_NEAR(giga(EncoderKind::kS, 640, 192), 5.86, 0.01);
  EXPECT_NEAR(giga(EncoderKind::kXs, 1024, 320), 11.98, 0.01);
}

// Golden: the arena of activations. A change is a decision, not an accident.
TEST(NetworkPlan, ArenaBytesAreKnownBeforeAnythingIsAllocated) {
  const auto bytes = [](EncoderKind encoder, PresetKind preset, int width, int height) {
    return plan_network(make_network(encoder, preset, width, height), false).memory.bytes;
  };
  EXPECT_EQ(bytes(EncoderKind::kXxs, PresetKind::kLcdm, 640, 192), 8847360U);
  EXPECT_EQ(bytes(EncoderKind::kXs, PresetKind::kLcdm, 640, 192), 9584640U);
  // 24,576 of them group norm's moments, two of 16 channels for each row.
  EXPECT_EQ(bytes(EncoderKind::kXs, PresetKind::kPaper, 640, 192), 24109056U);
  EXPECT_EQ(bytes(EncoderKind::kXs, PresetKind::kLcdm, 640, 480), 23961600U);
  EXPECT_EQ(bytes(EncoderKind::kXs, PresetKind::kLcdm, 1024, 320), 25559040U);
  EXPECT_EQ(bytes(EncoderKind::kXxs, PresetKind::kLcdm, 1024, 320), 23592960U);
  EXPECT_EQ(bytes(EncoderKind::kS, PresetKind::kLcdm, 640, 192), 12779520U);
  EXPECT_EQ(bytes(EncoderKind::kS, PresetKind::kLcdm, 640, 480), 31948800U);
  EXPECT_EQ(bytes(EncoderKind::kS, PresetKind::kLcdm, 1024, 320), 34078720U);
}

// Golden: one worker's scratch. Vectors of eight floats (AVX2) have another 3x3 to few channels.
TEST(Program, ScratchBytesAreKnown) {
  const auto bytes = [](EncoderKind encoder, PresetKind preset, int width, int height) {
    const ModelConfig config = test::make_config(encoder, preset);
    const auto program = Program::build(make_network(encoder, preset, width, height),
                                        model_of(test::make_random_weights(config, 1), config), {});
    EXPECT_TRUE(program) << program.status().text();
    return program->scratch_bytes() - os::kGuardBytes;
  };
  const bool eight = kernels::vector_lanes() == 8;
  EXPECT_EQ(bytes(EncoderKind::kXxs, PresetKind::kLcdm, 640, 192), eight ? 1367488U : 1449344U);
  EXPECT_EQ(bytes(EncoderKind::kXs, PresetKind::kLcdm, 640, 192), eight ? 1367488U : 1449344U);
  EXPECT_EQ(bytes(EncoderKind::kXs, PresetKind::kPaper, 640, 192), 1321728U);
  EXPECT_EQ(bytes(EncoderKind::kXs, PresetKind::kLcdm, 1024, 320), eight ? 2184640U : 2315648U);
  EXPECT_EQ(bytes(EncoderKind::kS, PresetKind::kLcdm, 640, 192), 1540608U);
}

// Attention mixes every token with every other; a tensor of all pairs would grow sixteenfold.
TEST(NetworkPlan, FourTimesThePixelsTakeFourTimesTheMemory) {
  for (const auto encoder : {EncoderKind::kXxs, EncoderKind::kXs, EncoderKind::kS}) {
    const auto bytes = [&](int width, int height) {
      const Network network = make_network(encoder, PresetKind::kLcdm, width, height);
      return plan_network(network, false).memory.bytes;
    };
    EXPECT_EQ(bytes(1024, 384), 4 * bytes(512, 192));
  }
}

// A layer that is not stored is computed, and reads, when the next stored one is.
TEST(NetworkPlan, NoLayerWritesOverWhatIsStillToBeRead) {
  for (const auto& [preset, keep] : {std::pair{PresetKind::kPaper, false},
                                     {PresetKind::kLcdm, false},
                                     {PresetKind::kLcdm, true}}) {
    const Network network = make_network(EncoderKind::kXs, preset, 640, 480);
    const NetworkPlan plan = plan_network(network, keep);
    const auto end_of = [&](std::size_t i) {
      return plan.memory.offsets[i] + plan.lifetimes[i].bytes;
    };
    for (std::size_t i = 0; i < network.layers().size(); ++i) {
      const Layer& layer = network.layers()[i];
      std::size_t moment = i;
      while (!network.layers()[moment].stored) ++moment;
      std::vector<int> read;
      for (const Source& source : layer.inputs) read.push_back(source.layer);
      if (layer.residual >= 0) read.push_back(layer.residual);
      for (const int input : read) {
        const auto in = static_cast<std::size_t>(input);
        ASSERT_LT(in, i);
        // Nothing written from the input's own step to this one touches it.
        for (std::size_t writer = in + 1; writer <= moment; ++writer) {
          const bool apart = end_of(writer) <= plan.memory.offsets[in] ||
                             end_of(in) <= plan.memory.offsets[writer];
          ASSERT_TRUE(apart || plan.lifetimes[writer].bytes == 0 || plan.lifetimes[in].bytes == 0)
              << network.layers()[writer].name << " over " << network.layers()[in].name;
        }
      }
    }
  }
}

TEST(NetworkPlan, TableListsEveryLayer) {
  const Network network = make_network(EncoderKind::kXxs, PresetKind::kLcdm, 640, 192);
  const auto rows = plan_rows(network);
  ASSERT_EQ(rows.size(), network.layers().size());
  const PlanRow& stem = rows[1];
  EXPECT_EQ(stem.name, "encoder.stem");
  EXPECT_STREQ(stem.kind, "conv");
  EXPECT_EQ(stem.macs, 96LL * 320 * 16 * 27);
  EXPECT_EQ(stem.bytes, 96U * 320 * 16 * 4);
  EXPECT_EQ(stem.first, 1);
  EXPECT_EQ(stem.last, 4);  // the residual of the first block
}

}  // namespace
}  // namespace lcdm
