#include "model/weight_import.h"

#include <array>
#include <regex>
#include <sstream>
#include <utility>

#include "model/checkpoint.h"

namespace lcdm::model {
namespace {

using Tensors = std::map<std::string, torch::Tensor>;

// ml-cvnets' names (cvnets/models/classification/mobilevit.py, modules/mobilevit_block.py,
// modules/mobilenetv2.py, modules/transformer.py) as timm's. Applied in order.
const std::vector<std::pair<std::regex, std::string>>& cvnets_names() {
  static const std::vector<std::pair<std::regex, std::string>> rules = [] {
    constexpr std::array<std::pair<const char*, const char*>, 18> texts = {{
        {R"(^conv_1\.block\.)", "stem."},
        {R"(^conv_1x1_exp\.block\.)", "final_conv."},
        {R"(^layer_1\.)", "stages.0."},
        {R"(^layer_2\.)", "stages.1."},
        {R"(^layer_3\.)", "stages.2."},
        {R"(^layer_4\.)", "stages.3."},
        {R"(^layer_5\.)", "stages.4."},
        {R"(\.block\.exp_1x1\.block\.)", ".conv1_1x1."},
        {R"(\.block\.conv_3x3\.block\.)", ".conv2_kxk."},
        {R"(\.block\.red_1x1\.block\.)", ".conv3_1x1."},
        {R"(\.local_rep\.conv_3x3\.block\.)", ".conv_kxk."},
        {R"(\.local_rep\.conv_1x1\.block\.conv\.)", ".conv_1x1."},
        {R"(\.conv_proj\.block\.)", ".conv_proj."},
        {R"(\.fusion\.block\.)", ".conv_fusion."},
        {R"(\.global_rep\.(\d+)\.pre_norm_mha\.0\.)", ".transformer.$1.norm1."},
        {R"(\.global_rep\.(\d+)\.pre_norm_mha\.1\.)", ".transformer.$1.attn."},
        {R"(\.global_rep\.(\d+)\.pre_norm_ffn\.)", ".transformer.$1.ffn."},
        {R"(\.global_rep\.\d+\.)", ".norm."},
    }};
    constexpr std::array<std::pair<const char*, const char*>, 6> inner = {{
        {R"(\.qkv_proj\.)", ".qkv."},
        {R"(\.out_proj\.)", ".proj."},
        {R"(\.ffn\.0\.)", ".norm2."},
        {R"(\.ffn\.1\.)", ".mlp.fc1."},
        {R"(\.ffn\.4\.)", ".mlp.fc2."},
        // What is left of `block.norm` after the block's own name.
        {R"((stem|final_conv|conv1_1x1|conv2_kxk|conv3_1x1|conv_kxk|conv_proj|conv_fusion)\.norm\.)",
         "$1.bn."},
    }};
    std::vector<std::pair<std::regex, std::string>> made;
    for (const auto& [from, to] : texts) made.emplace_back(std::regex(from), to);
    for (const auto& [from, to] : inner) made.emplace_back(std::regex(from), to);
    return made;
  }();
  return rules;
}

Tensors with_timm_names(const Tensors& tensors) {
  Tensors out;
  for (const auto& [name, tensor] : tensors) {
    std::string text = name;
    if (text.rfind("conv_1.", 0) == 0 || text.rfind("layer_", 0) == 0 ||
        text.rfind("conv_1x1_exp.", 0) == 0) {
      for (const auto& [from, to] : cvnets_names()) text = std::regex_replace(text, from, to);
    }
    out[text] = tensor;
  }
  return out;
}

std::string shape_text(const torch::Tensor& tensor) {
  std::ostringstream text;
  text << tensor.sizes();
  return text.str();
}

// Copies every tensor of `network` from `tensors`, after all of them were found to fit.
Result<ImportReport> copy_all(const Tensors& tensors, torch::nn::Module& network) {
  const torch::NoGradGuard no_grad;
  Tensors mine;
  collect(network, "", mine);
  ImportReport report;
  for (const auto& [name, tensor] : mine) {
    const bool counter = name.find("num_batches_tracked") != std::string::npos;
    const auto found = tensors.find(name);
    if (found == tensors.end() && counter) continue;  // of no use to anybody
    if (found == tensors.end()) {
      return Status::error(StatusCode::kInvalidInput,
                           "%s is not in the file: give weights of this encoder by timm's, "
                           "torchvision's or ml-cvnets' names",
                           name.c_str());
    }
    if (found->second.sizes() != tensor.sizes()) {
      return Status::error(StatusCode::kInvalidInput, "%s is %s in the file, but %s here",
                           name.c_str(), shape_text(found->second).c_str(),
                           shape_text(tensor).c_str());
    }
  }
  for (const auto& [name, tensor] : tensors) {
    const auto place = mine.find(name);
    if (place == mine.end()) {
      report.unused.push_back(name);
      continue;
    }
    place->second.copy_(tensor);
    ++report.taken;
  }
  return report;
}

}  // namespace

Result<ImportReport> import_mobilevit(const TensorFile& file, ChannelOrder order,
                                      MobileVit& encoder) {
  Tensors tensors = with_timm_names(file.tensors);
  const auto first = tensors.find("stem.conv.weight");
  if (order == ChannelOrder::kBgr && first != tensors.end() && first->second.dim() == 4) {
    first->second = first->second.flip(1);
  }
  return copy_all(tensors, *encoder);
}

Result<ImportReport> import_resnet18(const TensorFile& file, ResNet18& encoder) {
  Tensors tensors = file.tensors;
  const auto first = tensors.find("conv1.weight");
  const std::int64_t channels = encoder->conv1->weight.size(1);
  if (first != tensors.end() && first->second.dim() == 4 && first->second.size(1) == 3 &&
      channels == 6) {
    first->second = torch::cat({first->second, first->second}, 1) / 2;
  }
  return copy_all(tensors, *encoder);
}

}  // namespace lcdm::model
