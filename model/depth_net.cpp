#include "model/depth_net.h"

#include <cmath>
#include <string>
#include <torch/nn/functional/activation.h>
#include <torch/nn/functional/padding.h>
#include <torch/nn/functional/upsampling.h>

namespace lcdm::model {
namespace {

namespace F = torch::nn::functional;
using torch::Tensor;

constexpr double kMinDisparity = 0.01;    // of 100 m
constexpr double kDisparityRange = 9.99;  // up to 10, of 0.1 m

torch::nn::Conv2d conv3x3(int in, int out, bool reflect = false) {
  auto options = torch::nn::Conv2dOptions(in, out, 3).padding(1);
  if (reflect) options.padding_mode(torch::kReflect);
  return torch::nn::Conv2d(options);
}

}  // namespace

DecoderImpl::DecoderImpl(const ModelConfig& config) : paper(config.preset == PresetKind::kPaper) {
  const auto taps = EncoderShape::of(config.encoder).taps();
  const auto& widths = config.decoder_widths;
  int in = taps[4];
  for (int i = 4; i >= 0; --i) {
    const auto at = static_cast<std::size_t>(i);
    const std::string name = "upconv_" + std::to_string(i);
    levels[at].before = register_module(name + "_0", conv3x3(in, widths[at], paper));
    const int skip = i > 0 ? taps[at - 1] : 0;
    levels[at].after = register_module(name + "_1", conv3x3(widths[at] + skip, widths[at], paper));
    in = widths[at];
  }
  condition = register_module("condition", conv3x3(in, config.condition_channels, paper));
}

Tensor DecoderImpl::upsample2(const Tensor& x) const {
  auto options = F::InterpolateFuncOptions().scale_factor(std::vector<double>{2, 2});
  if (paper) return F::interpolate(x, options.mode(torch::kNearest));
  return F::interpolate(x, options.mode(torch::kBilinear).align_corners(false));
}

Tensor DecoderImpl::forward(const std::array<Tensor, 5>& taps) {
  Tensor x = taps[4];
  for (int i = 4; i >= 0; --i) {
    const auto at = static_cast<std::size_t>(i);
    x = upsample2(torch::elu(levels[at].before(x)));
    if (i > 0) x = torch::cat({x, taps[at - 1]}, 1);
    x = torch::elu(levels[at].after(x));
  }
  return torch::elu(condition(x));
}

HeadImpl::HeadImpl(const ModelConfig& config)
    : paper(config.preset == PresetKind::kPaper), steps(config.steps) {
  const int channels = config.condition_channels;
  embed = register_module("embed", conv3x3(1, channels));
  time_embed = register_module("time_embed",
                               torch::nn::Embedding(int{ModelConfig::kDiffusionSteps}, channels));
  conv1 = register_module("conv1", conv3x3(channels, channels));
  if (paper) {
    group_norm = register_module(
        "norm", torch::nn::GroupNorm(torch::nn::GroupNormOptions(4, channels).eps(1e-5)));
  } else {
    auto norms = std::make_shared<torch::nn::Module>();
    for (std::size_t k = 0; k < steps.size(); ++k) {
      step_norms.push_back(norms->register_module(
          std::to_string(k),
          torch::nn::BatchNorm2d(torch::nn::BatchNorm2dOptions(channels).eps(1e-5))));
    }
    register_module("norm", norms);
  }
  conv2 = register_module("conv2", conv3x3(channels, 1));
}

int HeadImpl::norm_index(int t) const {
  int nearest = 0;
  for (std::size_t k = 1; k < steps.size(); ++k) {
    if (std::abs(steps[k] - t) < std::abs(steps[static_cast<std::size_t>(nearest)] - t)) {
      nearest = static_cast<int>(k);
    }
  }
  return nearest;
}

Tensor HeadImpl::normalise(const Tensor& h, const Tensor& t) {
  if (paper) return group_norm(h);
  const Tensor on_cpu = t.to(torch::kCPU);
  std::vector<std::vector<int64_t>> members(step_norms.size());
  for (int64_t i = 0; i < on_cpu.size(0); ++i) {
    const int k = norm_index(static_cast<int>(on_cpu[i].item<int64_t>()));
    members[static_cast<std::size_t>(k)].push_back(i);
  }
  for (std::size_t k = 0; k < members.size(); ++k) {
    if (static_cast<int64_t>(members[k].size()) == h.size(0)) return step_norms[k](h);
  }
  Tensor out = torch::empty_like(h);
  for (std::size_t k = 0; k < members.size(); ++k) {
    if (members[k].empty()) continue;
    const Tensor index = torch::tensor(members[k], torch::kLong).to(h.device());
    out = out.index_copy(0, index, step_norms[k](h.index_select(0, index)));
  }
  return out;
}

Tensor HeadImpl::forward(const Tensor& condition, const Tensor& x, const Tensor& t) {
  const Tensor time = time_embed(t).view({t.size(0), -1, 1, 1});
  return conv2(torch::relu(normalise(conv1(condition + time + embed(x)), t)));
}

DepthNetImpl::DepthNetImpl(const ModelConfig& config_)
    : config(config_), abar(cumulative_alphas(config_.preset)) {
  encoder = register_module("encoder", Encoder(config.encoder));
  decoder = register_module("decoder", Decoder(config));
  head = register_module("head", Head(config));
  direct = register_module("direct", conv3x3(config.condition_channels, 1));
}

Tensor DepthNetImpl::condition(const Tensor& image) { return decoder(encoder(image)); }

Tensor DepthNetImpl::sample(const Tensor& condition, const Tensor& start,
                            const std::vector<int>& sampler) {
  Tensor x = start;
  for (std::size_t k = 0; k < sampler.size(); ++k) {
    const auto t = torch::full({x.size(0)}, sampler[k],
                               torch::TensorOptions().dtype(torch::kLong).device(x.device()));
    const double a = abar[static_cast<std::size_t>(sampler[k])];
    const double next =
        k + 1 < sampler.size() ? abar[static_cast<std::size_t>(sampler[k + 1])] : 1.0;
    const Tensor out = head(condition, x, t);
    Tensor x0, e;
    if (head->paper) {
      x0 = (x - std::sqrt(1 - a) * out) / std::sqrt(a);
      e = out;
    } else {
      x0 = std::sqrt(a) * x - std::sqrt(1 - a) * out;
      e = std::sqrt(1 - a) * x + std::sqrt(a) * out;
    }
    x = std::sqrt(next) * x0 + std::sqrt(1 - next) * e;
  }
  return x;
}

Tensor DepthNetImpl::abar_at(const Tensor& t) const {
  const Tensor table = torch::tensor(abar, torch::kDouble).to(t.device(), torch::kFloat);
  return table.index_select(0, t).view({-1, 1, 1, 1});
}

Tensor DepthNetImpl::add_noise(const Tensor& x0, const Tensor& noise, const Tensor& t) const {
  const Tensor a = abar_at(t);
  return a.sqrt() * x0 + (1 - a).sqrt() * noise;
}

Tensor DepthNetImpl::target(const Tensor& x0, const Tensor& noise, const Tensor& t) const {
  if (head->paper) return noise;
  const Tensor a = abar_at(t);
  return a.sqrt() * noise - (1 - a).sqrt() * x0;
}

Tensor DepthNetImpl::clean_estimate(const Tensor& x, const Tensor& prediction,
                                    const Tensor& t) const {
  const Tensor a = abar_at(t);
  if (head->paper) return (x - (1 - a).sqrt() * prediction) / a.sqrt();
  return a.sqrt() * x - (1 - a).sqrt() * prediction;
}

Tensor DepthNetImpl::to_depth(const Tensor& variable) const {
  const Tensor logit = variable * config.variable_std + config.variable_mean;
  return 1 / (kMinDisparity + kDisparityRange * torch::sigmoid(logit));
}

Tensor DepthNetImpl::to_variable(const Tensor& depth) const {
  const Tensor disparity = ((1 / depth - kMinDisparity) / kDisparityRange).clamp(1e-4, 1 - 1e-4);
  return (torch::logit(disparity) - config.variable_mean) / config.variable_std;
}

}  // namespace lcdm::model
