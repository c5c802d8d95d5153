// The network of a model file, computed with LibTorch's functions: what the engine is held to, and
// how an exported file is evaluated. Written from NETWORK.md a second time, without modules.
#pragma once

#include <map>
#include <string>
#include <torch/types.h>

#include "firmware/base/status.h"
#include "firmware/nn/model_file.h"

namespace lcdm::model {

class FoldedNet {
 public:
  explicit FoldedNet(const ModelFile& file);

  const ModelConfig& config() const { return config_; }

  // image [1, 3, H, W] normalised -> depth [1, 1, H, W] at the canonical focal length, metres,
  // from the model's own start.
  torch::Tensor forward(const torch::Tensor& image);

  // The outputs of the last forward by layer name (NETWORK.md), each [1, channels, h, w].
  const std::map<std::string, torch::Tensor>& outputs() const { return outputs_; }

 private:
  enum class Act { kNone, kSilu, kElu };
  struct ConvOptions {
    int stride = 1;
    Act act = Act::kNone;
    bool reflect = false;
  };

  const torch::Tensor& weight(const std::string& name) const;
  torch::Tensor note(const std::string& name, const torch::Tensor& value);
  torch::Tensor conv(const std::string& name, const torch::Tensor& x, const ConvOptions& options);
  torch::Tensor mv2(const std::string& name, const torch::Tensor& x, int stride);
  torch::Tensor layer_norm(const std::string& name, const torch::Tensor& x) const;
  torch::Tensor linear(const std::string& name, const torch::Tensor& x) const;
  torch::Tensor transformer(const std::string& name, const torch::Tensor& x) const;
  torch::Tensor mobile_vit(const std::string& name, const torch::Tensor& x, int depth);
  torch::Tensor decode(const torch::Tensor (&taps)[5]);
  torch::Tensor sample(const torch::Tensor& condition);
  torch::Tensor evaluate_head(std::size_t step, const torch::Tensor& condition,
                              const torch::Tensor& x) const;

  ModelConfig config_;
  bool paper_;
  std::map<std::string, torch::Tensor> weights_;
  std::map<std::string, torch::Tensor> outputs_;
};

}  // namespace lcdm::model
