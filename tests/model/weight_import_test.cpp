// Files of the form others publish, made here: every tensor must find its place.
#include "model/weight_import.h"

#include <gtest/gtest.h>
#include <regex>

namespace lcdm::model {
namespace {

TensorFile file_of(const torch::nn::Module& module) {
  TensorFile file;
  for (const auto& item : module.named_parameters()) file.tensors[item.key()] = item.value();
  for (const auto& item : module.named_buffers()) file.tensors[item.key()] = item.value();
  return file;
}

// timm's name -> ml-cvnets', for the final norm of a block with `depth` transformers.
std::string cvnets_name(std::string name, int depth) {
  const auto replace = [&name](const char* from, const std::string& to) {
    name = std::regex_replace(name, std::regex(from), to);
  };
  replace(R"(\.bn\.)", ".norm.");
  replace(R"(^stem\.)", "conv_1.block.");
  replace(R"(^final_conv\.)", "conv_1x1_exp.block.");
  replace(R"(\.norm1\.)", ".pre_norm_mha.0.");
  replace(R"(\.attn\.qkv\.)", ".pre_norm_mha.1.qkv_proj.");
  replace(R"(\.attn\.proj\.)", ".pre_norm_mha.1.out_proj.");
  replace(R"(\.norm2\.)", ".pre_norm_ffn.0.");
  replace(R"(\.mlp\.fc1\.)", ".pre_norm_ffn.1.");
  replace(R"(\.mlp\.fc2\.)", ".pre_norm_ffn.4.");
  replace(R"(\.transformer\.)", ".global_rep.");
  replace(R"(^(stages\.\d\.1)\.norm\.)", "$1.global_rep." + std::to_string(depth) + ".");
  replace(R"(\.conv1_1x1\.)", ".block.exp_1x1.block.");
  replace(R"(\.conv2_kxk\.)", ".block.conv_3x3.block.");
  replace(R"(\.conv3_1x1\.)", ".block.red_1x1.block.");
  replace(R"(\.conv_kxk\.)", ".local_rep.conv_3x3.block.");
  replace(R"(\.conv_1x1\.)", ".local_rep.conv_1x1.block.conv.");
  replace(R"(\.conv_proj\.)", ".conv_proj.block.");
  replace(R"(\.conv_fusion\.)", ".fusion.block.");
  for (int stage = 0; stage < 5; ++stage) {
    replace(("^stages\\." + std::to_string(stage) + "\\.").c_str(),
            "layer_" + std::to_string(stage + 1) + ".");
  }
  return name;
}

TensorFile cvnets_file_of(const MobileVit& encoder) {
  constexpr int kDepths[5] = {0, 0, 2, 4, 3};
  TensorFile file;
  for (const auto& [name, tensor] : file_of(*encoder).tensors) {
    const int depth = name.rfind("stages.", 0) == 0 ? kDepths[name[7] - '0'] : 0;
    file.tensors[cvnets_name(name, depth)] = tensor;
  }
  return file;
}

class WeightImport : public testing::Test {
 protected:
  void SetUp() override {
    torch::manual_seed(1);
    theirs_ = MobileVit(EncoderKind::kXs);
    ours_ = MobileVit(EncoderKind::kXs);
    theirs_->eval();
    ours_->eval();
  }
  // Whether both encoders see the same in a picture.
  bool agree() {
    const torch::NoGradGuard no_grad;
    const torch::Tensor picture = torch::rand({1, 3, 64, 64});
    return torch::equal(theirs_->forward(picture)[4], ours_->forward(picture)[4]);
  }
  MobileVit theirs_ = nullptr;
  MobileVit ours_ = nullptr;
};

TEST_F(WeightImport, TakesTimmsNamesAndReportsTheClassifier) {
  TensorFile file = file_of(*theirs_);
  file.tensors["head.fc.weight"] = torch::rand({1000, 384});
  const auto report = import_mobilevit(file, ChannelOrder::kRgb, ours_);
  ASSERT_TRUE(report) << report.status().text();
  EXPECT_EQ(report->unused, std::vector<std::string>{"head.fc.weight"});
  EXPECT_EQ(report->taken, file.tensors.size() - 1);
  EXPECT_TRUE(agree());
}

TEST_F(WeightImport, TakesCvnetsNames) {
  const TensorFile file = cvnets_file_of(theirs_);
  ASSERT_EQ(file.tensors.count("layer_4.1.global_rep.3.pre_norm_mha.1.qkv_proj.weight"), 1U);
  ASSERT_EQ(file.tensors.count("layer_4.1.global_rep.4.weight"), 1U);
  ASSERT_EQ(file.tensors.count("layer_1.0.block.red_1x1.block.norm.bias"), 1U);
  const auto report = import_mobilevit(file, ChannelOrder::kRgb, ours_);
  ASSERT_TRUE(report) << report.status().text();
  EXPECT_TRUE(report->unused.empty()) << report->unused[0];
  EXPECT_TRUE(agree());
}

TEST_F(WeightImport, TurnsTheFirstConvolutionRoundForBgr) {
  ASSERT_TRUE(import_mobilevit(file_of(*theirs_), ChannelOrder::kBgr, ours_));
  const torch::NoGradGuard no_grad;
  const torch::Tensor picture = torch::rand({1, 3, 64, 64});
  EXPECT_TRUE(torch::allclose(theirs_->forward(picture.flip(1))[4], ours_->forward(picture)[4],
                              1e-4, 1e-5));
}

TEST_F(WeightImport, RefusesAnotherEncoderAndChangesNothing) {
  const torch::Tensor before = ours_->stem->conv->weight.clone();
  const auto report =
      import_mobilevit(file_of(*MobileVit(EncoderKind::kXxs)), ChannelOrder::kRgb, ours_);
  EXPECT_EQ(report.code(), StatusCode::kInvalidInput);
  TensorFile lacking = file_of(*theirs_);
  lacking.tensors.erase("final_conv.conv.weight");
  const auto other = import_mobilevit(lacking, ChannelOrder::kRgb, ours_);
  EXPECT_NE(std::string(other.status().text()).find("final_conv.conv.weight"), std::string::npos);
  EXPECT_TRUE(torch::equal(before, ours_->stem->conv->weight));
}

TEST(ResNetImport, SharesTheFirstConvolutionBetweenTwoPictures) {
  torch::manual_seed(2);
  ResNet18 theirs(3);
  ResNet18 ours(6);
  theirs->eval();
  ours->eval();
  TensorFile file = file_of(*theirs);
  file.tensors["fc.weight"] = torch::rand({1000, 512});
  const auto report = import_resnet18(file, ours);
  ASSERT_TRUE(report) << report.status().text();
  EXPECT_EQ(report->unused, std::vector<std::string>{"fc.weight"});
  const torch::NoGradGuard no_grad;
  const torch::Tensor picture = torch::rand({1, 3, 64, 64});
  EXPECT_TRUE(torch::allclose(theirs->forward(picture),
                              ours->forward(torch::cat({picture, picture}, 1)), 1e-3, 1e-4));
}

}  // namespace
}  // namespace lcdm::model
