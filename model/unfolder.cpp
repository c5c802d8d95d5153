#include "model/unfolder.h"

#include <span>

#include "firmware/nn/model_file.h"
#include "firmware/nn/network.h"
#include "model/recipe.h"
#include "model/safetensors.h"

namespace lcdm::model {
namespace {

using Tensors = std::map<std::string, torch::Tensor>;

Tensors tensors_of(const ModelFile& file) {
  Tensors tensors;
  for (const auto& [name, tensor] : file.tensors()) {
    torch::Tensor values = torch::empty(tensor.shape, torch::kFloat);
    file.read(tensor, std::span(values.data_ptr<float>(), tensor.count));
    tensors[name] = values;
  }
  return tensors;
}

// Folding multiplied every filter by what its norm does to it, which makes it several times
// smaller; learning rates are made for filters of the size they begin with, and would overwrite it
// in a few steps. So each becomes as large as a new one, and its norm undoes that. Returns what the
// norm multiplies by, [out].
torch::Tensor enlarge_filters(const torch::Tensor& folded, torch::Tensor& weight) {
  const auto size_of = [](const torch::Tensor& filters) {
    return filters.square().mean({1, 2, 3}).sqrt().clamp_min(1e-6);
  };
  const torch::Tensor factor = size_of(weight).mean() / size_of(folded);
  weight.copy_(folded * factor.reshape({-1, 1, 1, 1}));
  return 1 / factor;
}

// Multiplies by `scale` and adds `bias`, in evaluation mode.
void set_norm(NormImpl& bn, const torch::Tensor& scale, const torch::Tensor& bias) {
  bn.weight.copy_(scale);
  bn.bias.copy_(bias);
  bn.running_mean.zero_();
  bn.running_var.fill_(1 - bn.options.eps());
}

// Layers that go into the file as they are, below `module` of that name.
void copy_plain(torch::nn::Module& module, const std::string& prefix, const Tensors& from) {
  for (auto& item : module.named_parameters()) {
    const auto found = from.find(prefix + item.key());
    if (found != from.end()) item.value().copy_(found->second);
  }
}

void unfold_encoder(const Tensors& from, MobileVit& encoder) {
  copy_plain(*encoder, "encoder.", from);
  for (const auto& item : encoder->named_modules("encoder", false)) {
    auto* block = item.value()->as<ConvNorm>();
    if (block == nullptr) continue;
    const torch::Tensor& bias = from.at(item.key() + ".bias");
    const torch::Tensor scale =
        enlarge_filters(from.at(item.key() + ".weight"), block->conv->weight);
    set_norm(*block->bn, scale, bias);
  }
}

void unfold_decoder(const Tensors& from, Decoder& decoder) {
  for (std::size_t i = 0; i < decoder->upconv.size(); ++i) {
    for (std::size_t j = 0; j < 2; ++j) {
      copy_plain(*decoder->upconv[i][j],
                 "decoder.upconv_" + std::to_string(i) + "_" + std::to_string(j) + ".", from);
    }
  }
  copy_plain(*decoder->condition, "decoder.condition.", from);
}

void unfold_head(const Tensors& from, DepthNetwork& network) {
  Head& head = network->head;
  const std::vector<int>& steps = network->config.steps;
  const auto of_step = [&](std::size_t k, const char* name) -> const torch::Tensor& {
    return from.at("head.steps." + std::to_string(k) + name);
  };
  head->embed->weight.copy_(from.at("head.embed.weight"));
  head->embed->bias.zero_();
  for (int t = 0; t < ModelConfig::kDiffusionSteps; ++t) {
    const auto nearest = static_cast<std::size_t>(network->step_of(t));
    head->time_embed[t].copy_(of_step(nearest, ".embed.bias"));
  }
  head->conv1->weight.copy_(from.at("head.conv1.weight"));
  copy_plain(*head->conv2, "head.conv2.", from);
  if (head->norm.empty()) {
    head->conv1->bias.copy_(of_step(0, ".conv1.bias"));
    copy_plain(*head->group_norm, "head.norm.", from);
    return;
  }
  head->conv1->bias.zero_();
  for (std::size_t k = 0; k < steps.size(); ++k) {
    set_norm(*head->norm[k], of_step(k, ".conv1.scale"), of_step(k, ".conv1.bias"));
  }
}

}  // namespace

Result<DepthNetwork> unfold_model(const std::string& path) {
  const Result<ModelFile> file = ModelFile::load(path);
  if (!file) return file.status();
  const Result<Network> layers = Network::build(file->config(), kDeployed[0][0], kDeployed[0][1]);
  if (!layers) return layers.status();
  LCDM_RETURN_IF_ERROR(layers->check_weights(*file));
  const torch::NoGradGuard no_grad;
  const Tensors tensors = tensors_of(*file);
  DepthNetwork network(file->config());
  unfold_encoder(tensors, network->encoder);
  unfold_decoder(tensors, network->decoder);
  unfold_head(tensors, network);
  network->direct->weight.zero_();
  network->direct->bias.zero_();
  network->eval();
  return network;
}

Result<bool> is_checkpoint(const std::string& path) {
  const Result<TensorFile> file = read_tensors(path);
  if (!file) return file.status();
  return file->tensors.count("trainer.step") > 0;
}

}  // namespace lcdm::model
