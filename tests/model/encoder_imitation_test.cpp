// An encoder that begins as METER's.
#include "model/encoder_imitation.h"

#include <filesystem>
#include <gtest/gtest.h>
#include <numeric>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "model/checkpoint.h"
#include "model/weight_import.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;

class EncoderImitation : public testing::Test {
 protected:
  void SetUp() override {
    const std::string file = "../shared/teachers/meter_xxs_nyu_192x256.onnx";
    if (!fs::exists(file)) GTEST_SKIP() << file << " is not here";
    auto meter = read_meter_encoder(file, kImagenetPixels);
    ASSERT_TRUE(meter) << meter.status().text();
    meter_ = *meter;
    load_kitchen();
    shape_.width = 128;
    shape_.height = 128;
    shape_.canonical_focal = 160;
    shape_.images = 4;
    torch::manual_seed(1);
  }
  DepthNetwork new_network() const {
    ModelConfig config;
    config.encoder = EncoderKind::kXxs;
    return DepthNetwork(config);
  }
  std::array<double, 5> errors_of(DepthNetwork& network) {
    const torch::NoGradGuard no_grad;
    network->eval();
    const auto batch = make_batch(packs_, shape_, 7, 0);
    std::array<double, 5> numbers;
    const auto errors = imitation_errors(meter_, network->encoder, batch->rgb);
    for (std::size_t i = 0; i < 5; ++i) numbers[i] = errors[i].item<double>();
    return numbers;
  }

  MeterEncoder meter_;
  std::vector<Pack> packs_;
  BatchShape shape_;

 private:
  void load_kitchen() {
    std::vector<PackFrame> frames;
    for (const auto& entry : fs::directory_iterator("../shared/data/test_realsense_rooms/rgb")) {
      PackFrame frame;
      cv::cvtColor(cv::imread(entry.path().string()), frame.rgb, cv::COLOR_BGR2RGB);
      frame.depth = cv::Mat(frame.rgb.size(), CV_32F, cv::Scalar(2));
      frame.camera = CameraModel::from_field_of_view(frame.rgb.cols, frame.rgb.rows, 60);
      frames.push_back(frame);
    }
    Pack pack;
    pack.frames = std::make_shared<MemoryFrames>(frames, false);
    pack.use.tall_share = 1;
    pack.train.resize(frames.size());
    std::iota(pack.train.begin(), pack.train.end(), 0U);
    packs_ = {pack};
  }
};

double sum(const std::array<double, 5>& errors) {
  return std::accumulate(errors.begin(), errors.end(), 0.0);
}

// Where the layers are the same, only the activations differ.
TEST_F(EncoderImitation, TheFirstTapsAreMetersFromTheStart) {
  DepthNetwork network = new_network();
  const auto before = errors_of(network);
  start_as(meter_, network->encoder);
  const auto after = errors_of(network);
  for (const std::size_t tap : {0U, 1U}) {
    EXPECT_GT(before[tap], 1) << tap;
    EXPECT_LT(after[tap], 0.5) << tap;
  }
}

TEST_F(EncoderImitation, ComesNearerWithEveryTap) {
  DepthNetwork network = new_network();
  start_as(meter_, network->encoder);
  const auto before = errors_of(network);
  BatchLoader loader(packs_, {shape_}, 1, 0, 2);
  const Status status = imitate(meter_, network, loader, 40, [](std::int64_t, const auto&) {});
  ASSERT_TRUE(status) << status.text();
  const auto after = errors_of(network);
  for (std::size_t tap = 0; tap < 5; ++tap) EXPECT_LT(after[tap], before[tap]) << tap;
  EXPECT_LT(sum(after), sum(before) / 2);
}

TEST_F(EncoderImitation, IsWrittenUnderTheNamesThatATrainingStartsFrom) {
  DepthNetwork network = new_network();
  start_as(meter_, network->encoder);
  TensorFile file;
  collect(*network->encoder, "", file.tensors);
  DepthNetwork other = new_network();
  const auto report = import_mobilevit(file, ChannelOrder::kRgb, other->encoder);
  ASSERT_TRUE(report) << report.status().text();
  EXPECT_TRUE(report->unused.empty());
  EXPECT_EQ(errors_of(other), errors_of(network));
}

}  // namespace
}  // namespace lcdm::model
