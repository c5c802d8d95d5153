// With AddressSanitizer whoever runs over the end of a tensor or of a weight is reported, though
// all lie in one block.
#include <gtest/gtest.h>
#include <optional>
#include <span>

#include "firmware/base/os.h"
#include "firmware/nn/constant_store.h"
#include "firmware/nn/program.h"
#include "tests/support/random_model.h"

namespace lcdm {
namespace {

constexpr const char* kReported = "use-after-poison";

class MemoryGuard : public testing::Test {
 protected:
  void SetUp() override {
    if (os::kGuardBytes == 0) GTEST_SKIP() << "only with AddressSanitizer";
  }

  void build(bool keep_tensors) {
    const ModelConfig config = test::make_config(EncoderKind::kXxs, PresetKind::kLcdm);
    const auto model = ModelFile::parse(test::make_random_model(config, 1));
    ASSERT_TRUE(model) << model.status().text();
    Result<Network> network = Network::build(config, 64, 64);
    ASSERT_TRUE(network) << network.status().text();
    Result<Program> program = Program::build(*network, *model, {1, keep_tensors, {}});
    ASSERT_TRUE(program) << program.status().text();
    network_ = std::move(*network);
    program_ = std::move(*program);
    WorkerPool pool(1);
    program_->run(pool);
  }

  std::span<float> tensor(const char* name) { return program_->tensor(network_->find(name)); }

  std::optional<Network> network_;
  std::optional<Program> program_;
};

TEST_F(MemoryGuard, ReportsTheFirstFloatBehindATensor) {
  build(/*keep_tensors=*/true);
  for (const char* name : {"input", "encoder.stem", "head.conv1", "depth"}) {
    const std::span<float> values = tensor(name);
    values.back() = 1;
    EXPECT_DEATH(values.data()[values.size()] = 1, kReported) << name;
  }
}

TEST_F(MemoryGuard, ReportsATensorThatNoLayerReadsAnyMore) {
  build(/*keep_tensors=*/false);
  tensor("input").back() = 1;
  tensor("depth").back() = 1;
  EXPECT_DEATH(tensor("head.conv1").back() = 1, kReported);
}

TEST_F(MemoryGuard, ReportsTheFirstFloatBehindAConstant) {
  ConstantStore store;
  const Result<std::span<float>> piece = store.add(16);
  ASSERT_TRUE(piece && store.add(16));
  piece->back() = 1;
  EXPECT_DEATH(piece->data()[16] = 1, kReported);
}

}  // namespace
}  // namespace lcdm
