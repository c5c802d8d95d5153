#include "model/folded_net.h"

#include <cmath>
#include <span>
#include <stdexcept>
#include <torch/nn/functional/normalization.h>
#include <torch/nn/functional/padding.h>
#include <torch/nn/functional/upsampling.h>

#include "firmware/nn/noise.h"
#include "firmware/nn/sampler.h"

namespace lcdm::model {
namespace {

namespace F = torch::nn::functional;
using torch::Tensor;

constexpr int64_t kHeads = 4;
constexpr int kDepths[3] = {2, 4, 3};  // transformer blocks of stages 2, 3, 4

Tensor resize(const Tensor& x, int64_t height, int64_t width) {
  return F::interpolate(x, F::InterpolateFuncOptions()
                               .size(std::vector<int64_t>{height, width})
                               .mode(torch::kBilinear)
                               .align_corners(false));
}

}  // namespace

FoldedNet::FoldedNet(const ModelFile& file)
    : config_(file.config()), paper_(config_.preset == PresetKind::kPaper) {
  for (const auto& [name, tensor] : file.tensors()) {
    Tensor values = torch::empty(tensor.shape, torch::kFloat);
    file.read(tensor, std::span(values.data_ptr<float>(), tensor.count));
    weights_[name] = values;
  }
}

const Tensor& FoldedNet::weight(const std::string& name) const {
  const auto found = weights_.find(name);
  if (found == weights_.end()) throw std::runtime_error("the model file lacks " + name);
  return found->second;
}

Tensor FoldedNet::note(const std::string& name, const Tensor& value) {
  outputs_[name] = value;
  return value;
}

Tensor FoldedNet::conv(const std::string& name, const Tensor& x, const ConvOptions& options) {
  const Tensor& w = weight(name + ".weight");
  const int64_t pad = w.size(2) / 2;
  const int64_t groups = x.size(1) / w.size(1);
  const auto bias = weights_.find(name + ".bias");
  const bool reflect = options.reflect && pad > 0;
  const Tensor input =
      reflect ? F::pad(x, F::PadFuncOptions({pad, pad, pad, pad}).mode(torch::kReflect)) : x;
  Tensor y = torch::conv2d(input, w, bias == weights_.end() ? Tensor() : bias->second,
                           options.stride, reflect ? 0 : pad, 1, groups);
  if (options.act == Act::kSilu) y = torch::silu(y);
  if (options.act == Act::kElu) y = torch::elu(y);
  return y;
}

Tensor FoldedNet::mv2(const std::string& name, const Tensor& x, int stride) {
  const Tensor expanded = note(name + ".conv1_1x1", conv(name + ".conv1_1x1", x, {1, Act::kSilu}));
  const Tensor mixed =
      note(name + ".conv2_kxk", conv(name + ".conv2_kxk", expanded, {stride, Act::kSilu}));
  Tensor y = conv(name + ".conv3_1x1", mixed, {});
  if (stride == 1 && y.size(1) == x.size(1)) y = y + x;
  return note(name + ".conv3_1x1", y);
}

Tensor FoldedNet::layer_norm(const std::string& name, const Tensor& x) const {
  return torch::layer_norm(x, {x.size(-1)}, weight(name + ".weight"), weight(name + ".bias"), 1e-5);
}

Tensor FoldedNet::linear(const std::string& name, const Tensor& x) const {
  return torch::linear(x, weight(name + ".weight"), weight(name + ".bias"));
}

Tensor FoldedNet::transformer(const std::string& name, const Tensor& x) const {
  const int64_t width = x.size(2);
  const auto parts = linear(name + ".attn.qkv", layer_norm(name + ".norm1", x)).chunk(3, 2);
  const auto heads = [&](const Tensor& t) {
    return t.reshape({t.size(0), t.size(1), kHeads, width / kHeads}).transpose(1, 2);
  };
  const Tensor scores = torch::matmul(heads(parts[0]), heads(parts[1]).transpose(2, 3)) /
                        std::sqrt(static_cast<double>(width / kHeads));
  const Tensor mixed = torch::matmul(torch::softmax(scores, -1), heads(parts[2]));
  const Tensor y = x + linear(name + ".attn.proj", mixed.transpose(1, 2).reshape(x.sizes()));
  return y + linear(name + ".mlp.fc2",
                    torch::silu(linear(name + ".mlp.fc1", layer_norm(name + ".norm2", y))));
}

Tensor FoldedNet::mobile_vit(const std::string& name, const Tensor& x, int depth) {
  Tensor y = note(name + ".conv_kxk", conv(name + ".conv_kxk", x, {1, Act::kSilu}));
  y = note(name + ".conv_1x1", conv(name + ".conv_1x1", y, {}));
  const int64_t h = y.size(2), w = y.size(3), d = y.size(1);
  const int64_t rows = (h + 1) / 2, columns = (w + 1) / 2;
  if (h % 2 != 0 || w % 2 != 0) y = resize(y, 2 * rows, 2 * columns);
  // pixel_unshuffle-like, but with the patch position as the batch: [4, tokens, d].
  Tensor tokens =
      y.reshape({d, rows, 2, columns, 2}).permute({2, 4, 1, 3, 0}).reshape({4, rows * columns, d});
  for (int j = 0; j < depth; ++j) {
    tokens = transformer(name + ".transformer." + std::to_string(j), tokens);
  }
  tokens = layer_norm(name + ".norm", tokens);
  y = tokens.reshape({2, 2, rows, columns, d})
          .permute({4, 2, 0, 3, 1})
          .reshape({1, d, 2 * rows, 2 * columns});
  if (y.size(2) != h || y.size(3) != w) y = resize(y, h, w);
  y = note(name + ".conv_proj", conv(name + ".conv_proj", y, {1, Act::kSilu}));
  return note(name + ".conv_fusion",
              conv(name + ".conv_fusion", torch::cat({x, y}, 1), {1, Act::kSilu}));
}

Tensor FoldedNet::decode(const Tensor (&taps)[5]) {
  Tensor x = taps[4];
  const ConvOptions options{1, Act::kElu, paper_};
  for (int i = 4; i >= 0; --i) {
    const std::string name = "decoder.upconv_" + std::to_string(i);
    x = note(name + "_0", conv(name + "_0", x, options));
    if (paper_) {
      x = x.repeat_interleave(2, 2).repeat_interleave(2, 3);
    } else {
      x = resize(x, 2 * x.size(2), 2 * x.size(3));
    }
    if (i > 0) x = torch::cat({x, taps[i - 1]}, 1);
    x = note(name + "_1", conv(name + "_1", x, options));
  }
  return note("decoder.condition", conv("decoder.condition", x, options));
}

Tensor FoldedNet::evaluate_head(std::size_t step, const Tensor& condition, const Tensor& x) const {
  const std::string name = "head.steps." + std::to_string(step);
  const Tensor fused =
      condition + torch::conv2d(x, weight("head.embed.weight"), weight(name + ".embed.bias"), 1, 1);
  const auto per_channel = [&](const char* what) {
    return weight(name + what).reshape({1, -1, 1, 1});
  };
  Tensor h = torch::conv2d(fused, weight("head.conv1.weight"), {}, 1, 1);
  h = h * per_channel(".conv1.scale") + per_channel(".conv1.bias");
  if (paper_) {
    h = torch::group_norm(h, 4, weight("head.norm.weight"), weight("head.norm.bias"), 1e-5);
  }
  return torch::conv2d(torch::relu(h), weight("head.conv2.weight"), weight("head.conv2.bias"), 1,
                       1);
}

// DDIM as NETWORK.md states it, step by step, without the engine's folded constants.
Tensor FoldedNet::sample(const Tensor& condition) {
  const std::vector<double> abar = cumulative_alphas(config_.preset);
  note("head.conv1", torch::conv2d(condition, weight("head.conv1.weight"), {}, 1, 1));
  Tensor x = torch::zeros({1, 1, condition.size(2), condition.size(3)});
  if (config_.start == StartKind::kNoise) {
    fill_gaussian(config_.seed,
                  std::span(x.data_ptr<float>(), static_cast<std::size_t>(x.numel())));
  }
  for (std::size_t k = 0; k < config_.steps.size(); ++k) {
    const double a = abar[static_cast<std::size_t>(config_.steps[k])];
    const bool last = k + 1 == config_.steps.size();
    const double next = last ? 1.0 : abar[static_cast<std::size_t>(config_.steps[k + 1])];
    const Tensor out = evaluate_head(k, condition, x);
    const Tensor x0 = paper_ ? (x - std::sqrt(1 - a) * out) / std::sqrt(a)
                             : std::sqrt(a) * x - std::sqrt(1 - a) * out;
    const Tensor noise = paper_ ? out : std::sqrt(1 - a) * x + std::sqrt(a) * out;
    x = std::sqrt(next) * x0 + std::sqrt(1 - next) * noise;
    note("head." + std::to_string(k), x);
  }
  return x;
}

Tensor FoldedNet::forward(const Tensor& image) {
  const torch::NoGradGuard no_grad;
  outputs_.clear();
  const ConvOptions silu{1, Act::kSilu};
  Tensor taps[5];
  Tensor x = note("encoder.stem", conv("encoder.stem", image, {2, Act::kSilu}));
  taps[0] = mv2("encoder.stages.0.0", x, 1);
  x = mv2("encoder.stages.1.0", taps[0], 2);
  x = mv2("encoder.stages.1.1", x, 1);
  taps[1] = x = mv2("encoder.stages.1.2", x, 1);
  for (int i = 0; i < 3; ++i) {
    const std::string stage = "encoder.stages." + std::to_string(i + 2);
    x = mv2(stage + ".0", x, 2);
    taps[i + 2] = x = mobile_vit(stage + ".1", x, kDepths[i]);
  }
  taps[4] = note("encoder.final_conv", conv("encoder.final_conv", x, silu));
  const Tensor logit = sample(decode(taps)) * config_.variable_std + config_.variable_mean;
  return note("depth", 1 / (0.01 + 9.99 * torch::sigmoid(logit)));
}

}  // namespace lcdm::model
