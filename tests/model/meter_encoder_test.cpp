// METER's published files, read without any other runtime.
#include "model/meter_encoder.h"

#include <filesystem>
#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "firmware/wire/bytes.h"
#include "firmware/wire/protobuf.h"
#include "model/onnx_weights.h"
#include "tests/support/temporary_folder.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;

const std::string kMeterOfKitti = "../shared/teachers/meter_xxs_kitti_192x640.onnx";

// METER's decoder, from what its encoder gives to decimetres at a quarter of the size.
class Decoder {
 public:
  explicit Decoder(std::map<std::string, std::vector<torch::Tensor>> weights)
      : weights_(std::move(weights)) {}

  torch::Tensor forward(const MeterFeatures& features) const {
    torch::Tensor x = convolve("conv2d_in", features.taps[4], 0);
    for (int i = 1; i <= 3; ++i) {
      const std::string name = "ups_block_" + std::to_string(i);
      const torch::Tensor up = torch::conv_transpose2d(
          x, weight(name + "/conv2d_transpose/ConvTranspose", 0), {}, 2, 1, 1);
      const std::string separable = name + "/end_up_layer/end_up_layer.0";
      x = torch::cat({up, features.skips[static_cast<std::size_t>(3 - i)]}, 1);
      x = torch::relu(
          convolve(separable + "/pointwise", convolve(separable + "/depthwise", x, 1), 0));
    }
    return convolve("conv2d_out", x, 1);
  }

 private:
  torch::Tensor weight(const std::string& name, std::size_t index) const {
    return weights_.at("/decoder/" + name).at(index);
  }
  torch::Tensor convolve(const std::string& name, const torch::Tensor& x, int padding) const {
    const auto& constants = weights_.at("/decoder/" + name + "/Conv");
    return torch::conv2d(x, constants.at(0), constants.size() > 1 ? constants[1] : torch::Tensor(),
                         1, padding);
  }

  std::map<std::string, std::vector<torch::Tensor>> weights_;
};

torch::Tensor picture_of(const std::string& path, cv::Size size) {
  cv::Mat rgb;
  cv::cvtColor(cv::imread(path), rgb, cv::COLOR_BGR2RGB);
  cv::resize(rgb, rgb, size, 0, 0, cv::INTER_AREA);
  return torch::from_blob(rgb.data, {1, rgb.rows, rgb.cols, 3}, torch::kUInt8)
      .to(torch::kFloat32)
      .div(255)
      .permute({0, 3, 1, 2})
      .contiguous();
}

// The maps were made by another runtime, which ran the whole file.
TEST(MeterEncoder, WithItsDecoderGivesTheMapsThatAnotherRuntimeGave) {
  if (!fs::exists(kMeterOfKitti)) GTEST_SKIP() << kMeterOfKitti << " is not here";
  const std::string drive = "../shared/data/driving_kitti_91/";
  const auto encoder = read_meter_encoder(kMeterOfKitti, kUnitPixels);
  ASSERT_TRUE(encoder) << encoder.status().text();
  const Decoder decoder(*read_onnx_weights(kMeterOfKitti));
  for (const char* name : {"000000", "000045"}) {
    const torch::Tensor rgb = picture_of(drive + "rgb/" + name + ".jpg", {640, 192});
    const torch::Tensor metres = decoder.forward(encoder->forward(rgb)) / 10;
    cv::Mat map = cv::imread(drive + "teacher_meter/" + name + ".png", cv::IMREAD_UNCHANGED);
    ASSERT_EQ(map.size(), cv::Size(160, 48));
    map.convertTo(map, CV_32F, 1.0 / 256);
    const torch::Tensor theirs = torch::from_blob(map.data, {1, 1, map.rows, map.cols});
    EXPECT_LT(((metres - theirs).abs() / theirs).mean().item<double>(), 0.03) << name;
  }
}

TEST(MeterEncoder, AnotherNetworkIsRefusedByTheOperatorThatItLacks) {
  test::TemporaryFolder folder;
  std::vector<std::byte> memory(1024);
  wire::ByteWriter bytes(memory);
  wire::ProtobufWriter(bytes).message_field(7, [] {});  // ModelProto.graph: empty
  const std::string path = folder.write("other.onnx", bytes.written());
  const auto encoder = read_meter_encoder(path, kUnitPixels);
  ASSERT_FALSE(encoder);
  EXPECT_EQ(encoder.status().code(), StatusCode::kInvalidInput);
  EXPECT_STREQ(encoder.status().text(), (path + ": not METER-XXS with its operators' names "
                                                "(/encoder/conv1/conv1.0/depthwise/Conv)")
                                            .c_str());
}

// ModelProto with one Conv of constants 'weight', 'bias' and an integer one.
std::vector<std::byte> network(std::uint64_t extent) {
  std::vector<std::byte> memory(4096);
  wire::ByteWriter bytes(memory);
  wire::ProtobufWriter out(bytes);
  const auto tensor = [&](std::string_view name, std::uint64_t type, std::uint64_t size,
                          std::size_t stored) {
    out.message_field(5, [&] {
      const std::vector<float> values(stored, 0.5F);
      out.varint_field(1, size);
      out.varint_field(2, type);
      out.string_field(8, name);
      out.bytes_field(9, std::as_bytes(std::span(values)));
    });
  };
  out.message_field(7, [&] {
    out.message_field(1, [&] {
      for (const char* input : {"picture", "weight", "shape", "bias"}) out.string_field(1, input);
      out.string_field(3, "/conv");
      out.string_field(4, "Conv");
    });
    tensor("weight", 1, extent, 6);
    tensor("shape", 7, 2, 4);
    tensor("bias", 1, 2, 2);
  });
  const auto written = bytes.written();
  return {written.begin(), written.end()};
}

TEST(OnnxWeights, AreAnOperatorsFloatsInOrder) {
  test::TemporaryFolder folder;
  const auto weights = read_onnx_weights(folder.write("net.onnx", network(6)));
  ASSERT_TRUE(weights) << weights.status().text();
  ASSERT_EQ(weights->size(), 1U);
  const auto& conv = weights->at("/conv");
  ASSERT_EQ(conv.size(), 2U);
  EXPECT_TRUE(torch::equal(conv[0], torch::full({6}, 0.5F)));
  EXPECT_TRUE(torch::equal(conv[1], torch::full({2}, 0.5F)));
}

TEST(OnnxWeights, AShapeThatItsBytesDoNotFillIsRefused) {
  test::TemporaryFolder folder;
  for (const std::uint64_t extent : {0ULL, 5ULL, 7ULL, 1ULL << 62, ~0ULL}) {
    const auto weights = read_onnx_weights(folder.write("net.onnx", network(extent)));
    ASSERT_FALSE(weights) << extent;
    EXPECT_EQ(weights.status().code(), StatusCode::kInvalidInput);
  }
}

TEST(OnnxWeights, ACutFileIsRefusedWhereverItEnds) {
  test::TemporaryFolder folder;
  const std::vector<std::byte> whole = network(6);
  for (std::size_t size = 0; size < whole.size(); ++size) {
    EXPECT_FALSE(read_onnx_weights(folder.write("net.onnx", std::span(whole).first(size)))) << size;
  }
}

TEST(OnnxWeights, AMissingFileIsNamed) {
  const auto weights = read_onnx_weights("/nowhere/net.onnx");
  ASSERT_FALSE(weights);
  EXPECT_NE(std::string(weights.status().text()).find("/nowhere/net.onnx"), std::string::npos);
}

}  // namespace
}  // namespace lcdm::model
