#include "model/checkpoint.h"

#include "model/safetensors.h"

namespace lcdm::model {

void collect(const torch::nn::Module& network, const std::string& prefix,
             std::map<std::string, torch::Tensor>& tensors) {
  for (const auto& item : network.named_parameters()) tensors[prefix + item.key()] = item.value();
  for (const auto& item : network.named_buffers()) tensors[prefix + item.key()] = item.value();
}

bool restore(torch::nn::Module& network, const std::string& prefix,
             const std::map<std::string, torch::Tensor>& tensors) {
  const torch::NoGradGuard no_grad;
  std::map<std::string, torch::Tensor> mine;
  collect(network, prefix, mine);
  for (auto& [name, tensor] : mine) {
    const auto found = tensors.find(name);
    if (found == tensors.end() || found->second.sizes() != tensor.sizes()) return false;
    tensor.copy_(found->second);
  }
  return true;
}

Result<DepthNetwork> load_checkpoint(const std::string& path) {
  const Result<TensorFile> file = read_tensors(path);
  if (!file) return file.status();
  const auto text = file->metadata.find("lcdm");
  if (text == file->metadata.end()) {
    return Status::error(StatusCode::kInvalidInput, "%s is not a training checkpoint",
                         path.c_str());
  }
  const Result<ModelConfig> config = parse_model_config(text->second);
  if (!config) return config.status();
  DepthNetwork network(*config);
  if (!restore(*network, "average.", file->tensors)) {
    return Status::error(StatusCode::kInvalidInput, "%s holds no averaged weights", path.c_str());
  }
  network->eval();
  return network;
}

}  // namespace lcdm::model
