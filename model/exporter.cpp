#include "model/exporter.h"

#include "model/checkpoint.h"
#include "model/config_json.h"
#include "model/safetensors.h"

namespace lcdm::model {
namespace {

using Tensors = std::map<std::string, torch::Tensor>;

// What BatchNorm with running statistics multiplies by; it adds bias - mean * scale.
torch::Tensor scale_of(const NormImpl& bn) {
  return bn.weight / (bn.running_var + bn.options.eps()).sqrt();
}

void put_conv(const torch::nn::Conv2d& conv, const std::string& name, Tensors& out) {
  out[name + ".weight"] = conv->weight;
  if (conv->bias.defined()) out[name + ".bias"] = conv->bias;
}

void fold_encoder(const MobileVit& encoder, Tensors& out) {
  for (const auto& item : encoder->named_modules("encoder", false)) {
    const std::string& name = item.key();
    if (const auto* block = item.value()->as<ConvNorm>()) {
      const torch::Tensor scale = scale_of(*block->bn);
      out[name + ".weight"] = block->conv->weight * scale.reshape({-1, 1, 1, 1});
      out[name + ".bias"] = block->bn->bias - block->bn->running_mean * scale;
    } else if (const auto* vit = item.value()->as<MobileVitBlock>()) {
      put_conv(vit->conv_1x1, name + ".conv_1x1", out);
    } else if (item.value()->as<torch::nn::Linear>() != nullptr ||
               item.value()->as<torch::nn::LayerNorm>() != nullptr) {
      for (const auto& parameter : item.value()->named_parameters()) {
        out[name + "." + parameter.key()] = parameter.value();
      }
    }
  }
}

void fold_head(const Head& head, const ModelConfig& config, Tensors& out) {
  out["head.embed.weight"] = head->embed->weight;
  out["head.conv1.weight"] = head->conv1->weight;
  for (std::size_t k = 0; k < config.steps.size(); ++k) {
    const std::string step = "head.steps." + std::to_string(k);
    out[step + ".embed.bias"] = head->embed->bias + head->time_embed[config.steps[k]];
    torch::Tensor scale = torch::ones_like(head->conv1->bias);
    torch::Tensor bias = head->conv1->bias;
    if (!head->norm.empty()) {
      scale = scale_of(*head->norm[k]);
      bias = (bias - head->norm[k]->running_mean) * scale + head->norm[k]->bias;
    }
    out[step + ".conv1.scale"] = scale;
    out[step + ".conv1.bias"] = bias;
  }
  if (head->norm.empty()) {
    out["head.norm.weight"] = head->group_norm->weight;
    out["head.norm.bias"] = head->group_norm->bias;
  }
  put_conv(head->conv2, "head.conv2", out);
}

bool compute_alike(const ModelConfig& a, const ModelConfig& b) {
  return a.encoder == b.encoder && a.preset == b.preset && a.decoder_widths == b.decoder_widths &&
         a.condition_channels == b.condition_channels && a.steps == b.steps &&
         a.variable_mean == b.variable_mean && a.variable_std == b.variable_std;
}

// Weights and norms' statistics are averaged before norms are folded into weights: the mean of
// folded weights is another network, and was worse on validation.
DepthNetwork mean_of(const std::vector<DepthNetwork>& networks) {
  const torch::NoGradGuard no_grad;
  Tensors mean;
  for (const DepthNetwork& network : networks) {
    Tensors own;
    collect(*network, "", own);
    for (const auto& [name, tensor] : own) {
      if (!tensor.is_floating_point()) {
        mean.try_emplace(name, tensor);  // a norm's count
      } else if (const auto [at, first] = mean.try_emplace(name, tensor.clone()); !first) {
        at->second += tensor;
      }
    }
  }
  for (auto& [name, tensor] : mean) {
    if (tensor.is_floating_point()) tensor /= static_cast<double>(networks.size());
  }
  DepthNetwork result(networks[0]->config);
  restore(*result, "", mean);
  return result;
}

}  // namespace

Tensors fold_network(const DepthNetwork& network) {
  const torch::NoGradGuard no_grad;
  Tensors out;
  fold_encoder(network->encoder, out);
  for (std::size_t i = 0; i < network->decoder->upconv.size(); ++i) {
    for (std::size_t j = 0; j < 2; ++j) {
      put_conv(network->decoder->upconv[i][j],
               "decoder.upconv_" + std::to_string(i) + "_" + std::to_string(j), out);
    }
  }
  put_conv(network->decoder->condition, "decoder.condition", out);
  fold_head(network->head, network->config, out);
  for (auto& [name, tensor] : out) tensor = tensor.detach().contiguous().clone();
  return out;
}

Status export_network(const DepthNetwork& network, const std::string& path) {
  return export_mean({network}, path);
}

Status export_mean(const std::vector<DepthNetwork>& networks, const std::string& path) {
  if (networks.empty()) return Status::error(StatusCode::kInvalidInput, "no network to export");
  const Result<std::string> config = config_json(networks[0]->config);
  if (!config) return config.status();
  for (std::size_t i = 1; i < networks.size(); ++i) {
    if (!compute_alike(networks[0]->config, networks[i]->config)) {
      return Status::error(StatusCode::kInvalidInput,
                           "checkpoints %zu and 1 have different networks or diffusion variables: "
                           "only states of one training can be averaged",
                           i + 1);
    }
  }
  TensorFile file{fold_network(mean_of(networks)), {{"lcdm", *config}}};
  for (auto& [name, tensor] : file.tensors) {
    tensor = tensor.to(torch::kFloat16).contiguous();
    if (!torch::isfinite(tensor).all().item<bool>()) {
      return Status::error(StatusCode::kInvalidInput, "%s does not fit into half precision",
                           name.c_str());
    }
  }
  return write_tensors(path, file);
}

}  // namespace lcdm::model
