#include "model/network.h"

#include <cmath>

#include "firmware/nn/noise.h"
#include "firmware/nn/sampler.h"
#include "model/autocast.h"
#include "model/bfloat16_silu.h"

namespace lcdm::model {
namespace {

namespace nn = torch::nn;
namespace F = torch::nn::functional;

constexpr double kNormEpsilon = 1e-5;
constexpr int kGroups = 4;

// Rounded to a multiple of 8, never more than 10 % down (MobileNetV2).
int make_divisible(int value) {
  const int rounded = std::max(8, (value + 4) / 8 * 8);
  return rounded * 10 < value * 9 ? rounded + 8 : rounded;
}

nn::Conv2d conv3x3(int in, int out, bool reflect = false) {
  nn::Conv2dOptions options(in, out, 3);
  options.padding(1);
  if (reflect) options.padding_mode(torch::kReflect);
  return nn::Conv2d(options);
}

// Keeps the variance through ELU: with LibTorch's own start the ten convolutions of the decoder,
// which have no norm, would let almost nothing of the coarse features through.
nn::Conv2d keep_variance(nn::Conv2d conv) {
  const torch::NoGradGuard no_grad;
  constexpr double kGain = 1.25;
  const auto fan_in = static_cast<double>(conv->weight.numel() / conv->weight.size(0));
  conv->weight.normal_(0, kGain / std::sqrt(fan_in));
  conv->bias.zero_();
  return conv;
}

// In floats on a processor: there LibTorch 1.13 takes seven times as long to go back through it in
// bfloat16.
torch::Tensor resize_bilinear(const torch::Tensor& x, std::int64_t height, std::int64_t width) {
  const torch::Tensor resized = F::interpolate(x.is_cpu() ? x.to(torch::kFloat32) : x,
                                               F::InterpolateFuncOptions()
                                                   .size(std::vector<std::int64_t>{height, width})
                                                   .mode(torch::kBilinear)
                                                   .align_corners(false));
  return resized.to(x.scalar_type());
}

}  // namespace

NormImpl::NormImpl(int channels) : NormImplBase(nn::BatchNormOptions(channels).eps(kNormEpsilon)) {}

torch::Tensor NormImpl::forward(const torch::Tensor& x) {
  if (adopts > 0) {
    const torch::Tensor scale = weight / (running_var + options.eps()).sqrt();
    const torch::Tensor shift = bias - running_mean * scale;
    const torch::Tensor seen = x.to(torch::kFloat32);  // under Autocast it is not
    running_mean.lerp_(seen.mean({0, 2, 3}), adopts);
    running_var.lerp_(seen.var({0, 2, 3}, true), adopts);
    if (keeps_answers) {
      weight.copy_(scale * (running_var + options.eps()).sqrt());
      bias.copy_(shift + running_mean * scale);
    }
  }
  if (is_training()) num_batches_tracked += 1;
  return torch::batch_norm(x, weight, bias, running_mean, running_var, is_training(),
                           *options.momentum(), options.eps(), true);
}

torch::Tensor NormImpl::forward_without_trace(const torch::Tensor& x) {
  return torch::batch_norm(x, weight, bias, {}, {}, true, 0, options.eps(), false);
}

void NormImpl::_check_input_dim(const torch::Tensor& x) {
  TORCH_CHECK(x.dim() == 4, "expected [batch, channels, height, width]");
}

ConvNormImpl::ConvNormImpl(int in, int out, int kernel, int stride, int groups, bool act)
    : activation(act) {
  conv = register_module("conv", nn::Conv2d(nn::Conv2dOptions(in, out, kernel)
                                                .stride(stride)
                                                .padding(kernel / 2)
                                                .groups(groups)
                                                .bias(false)));
  bn = register_module("bn", Norm(out));
}

torch::Tensor ConvNormImpl::forward(const torch::Tensor& x) {
  const torch::Tensor y = bn->forward(conv->forward(x));
  return activation ? silu_of(y) : y;
}

InvertedResidualImpl::InvertedResidualImpl(int in, int out, int stride, int ratio)
    : residual(stride == 1 && in == out) {
  const int hidden = make_divisible(in * ratio);
  conv1_1x1 = register_module("conv1_1x1", ConvNorm(in, hidden, 1, 1, 1, true));
  conv2_kxk = register_module("conv2_kxk", ConvNorm(hidden, hidden, 3, stride, hidden, true));
  conv3_1x1 = register_module("conv3_1x1", ConvNorm(hidden, out, 1, 1, 1, false));
}

torch::Tensor InvertedResidualImpl::forward(const torch::Tensor& x) {
  const torch::Tensor y = conv3_1x1->forward(conv2_kxk->forward(conv1_1x1->forward(x)));
  return residual ? y + x : y;
}

AttentionImpl::AttentionImpl(int dim) {
  qkv = register_module("qkv", nn::Linear(dim, 3 * dim));
  proj = register_module("proj", nn::Linear(dim, dim));
}

torch::Tensor AttentionImpl::forward(const torch::Tensor& x) {
  const std::int64_t sequences = x.size(0);
  const std::int64_t tokens = x.size(1);
  const std::int64_t head_dim = x.size(2) / kHeads;
  const torch::Tensor parts = qkv->forward(x)
                                  .reshape({sequences, tokens, 3, kHeads, head_dim})
                                  .permute({2, 0, 3, 1, 4});  // 3, sequences, heads, tokens, dim
  const double scale = 1 / std::sqrt(static_cast<double>(head_dim));
  const torch::Tensor weights =
      torch::softmax(torch::matmul(parts[0] * scale, parts[1].transpose(-2, -1)), -1);
  return proj->forward(torch::matmul(weights, parts[2]).transpose(1, 2).reshape(x.sizes()));
}

FeedForwardImpl::FeedForwardImpl(int dim) {
  fc1 = register_module("fc1", nn::Linear(dim, 2 * dim));
  fc2 = register_module("fc2", nn::Linear(2 * dim, dim));
}

torch::Tensor FeedForwardImpl::forward(const torch::Tensor& x) {
  return fc2->forward(silu_of(fc1->forward(x)));
}

TransformerImpl::TransformerImpl(int dim) {
  const nn::LayerNormOptions options = nn::LayerNormOptions({dim}).eps(kNormEpsilon);
  norm1 = register_module("norm1", nn::LayerNorm(options));
  attn = register_module("attn", Attention(dim));
  norm2 = register_module("norm2", nn::LayerNorm(options));
  mlp = register_module("mlp", FeedForward(dim));
}

// The sum and the norms stay in float, also under Autocast.
torch::Tensor TransformerImpl::forward(const torch::Tensor& tokens) {
  const torch::Tensor x = tokens.to(torch::kFloat32);
  const torch::Tensor y = x + attn->forward(norm1->forward(x));
  return y + mlp->forward(norm2->forward(y));
}

torch::Tensor unfold_patches(const torch::Tensor& x) {
  const std::int64_t height = x.size(2) / 2;
  const std::int64_t width = x.size(3) / 2;
  return x.reshape({x.size(0), x.size(1), height, 2, width, 2})
      .permute({0, 3, 5, 2, 4, 1})
      .reshape({x.size(0) * 4, height * width, x.size(1)});
}

torch::Tensor fold_patches(const torch::Tensor& tokens, std::int64_t batch, std::int64_t height,
                           std::int64_t width) {
  return tokens.reshape({batch, 2, 2, height / 2, width / 2, tokens.size(2)})
      .permute({0, 5, 3, 1, 4, 2})
      .reshape({batch, tokens.size(2), height, width});
}

MobileVitBlockImpl::MobileVitBlockImpl(int channels, int dim, int depth) {
  conv_kxk = register_module("conv_kxk", ConvNorm(channels, channels, 3, 1, 1, true));
  conv_1x1 =
      register_module("conv_1x1", nn::Conv2d(nn::Conv2dOptions(channels, dim, 1).bias(false)));
  transformer = register_module("transformer", nn::ModuleList());
  for (int j = 0; j < depth; ++j) transformer->push_back(Transformer(dim));
  norm = register_module("norm", nn::LayerNorm(nn::LayerNormOptions({dim}).eps(kNormEpsilon)));
  conv_proj = register_module("conv_proj", ConvNorm(dim, channels, 1, 1, 1, true));
  conv_fusion = register_module("conv_fusion", ConvNorm(2 * channels, channels, 3, 1, 1, true));
}

torch::Tensor MobileVitBlockImpl::forward(const torch::Tensor& x) {
  const std::int64_t height = x.size(2);
  const std::int64_t width = x.size(3);
  const std::int64_t even_height = (height + 1) / 2 * 2;
  const std::int64_t even_width = (width + 1) / 2 * 2;
  const bool odd = even_height != height || even_width != width;

  torch::Tensor y = conv_1x1->forward(conv_kxk->forward(x));
  if (odd) y = resize_bilinear(y, even_height, even_width);
  torch::Tensor tokens = unfold_patches(y);
  for (const auto& block : *transformer) tokens = block->as<Transformer>()->forward(tokens);
  y = fold_patches(norm->forward(tokens.to(torch::kFloat32)), x.size(0), even_height, even_width);
  if (odd) y = resize_bilinear(y, height, width);
  y = conv_proj->forward(y.contiguous(torch::MemoryFormat::ChannelsLast));
  return conv_fusion->forward(torch::cat({x, y}, 1));
}

MobileVitImpl::MobileVitImpl(EncoderKind kind) {
  const EncoderTable table = encoder_table(kind);
  stem = register_module("stem", ConvNorm(3, 16, 3, 2, 1, true));
  stages = register_module("stages", nn::ModuleList());

  nn::ModuleList first;
  first->push_back(InvertedResidual(16, table.early[0], 1, table.ratio));
  stages->push_back(first);
  nn::ModuleList second;
  for (int j = 0; j < 3; ++j) {
    second->push_back(
        InvertedResidual(table.early[j == 0 ? 0 : 1], table.early[1], j == 0 ? 2 : 1, table.ratio));
  }
  stages->push_back(second);
  int in = table.early[1];
  for (const EncoderTable::VitStage& stage : table.late) {
    nn::ModuleList blocks;
    blocks->push_back(InvertedResidual(in, stage.channels, 2, table.ratio));
    blocks->push_back(MobileVitBlock(stage.channels, stage.dim, stage.depth));
    stages->push_back(blocks);
    in = stage.channels;
  }
  final_conv = register_module("final_conv", ConvNorm(in, table.final_channels, 1, 1, 1, true));
  channels = {table.early[0], table.early[1], table.late[0].channels, table.late[1].channels,
              table.final_channels};
}

std::array<torch::Tensor, 5> MobileVitImpl::forward(const torch::Tensor& rgb) {
  std::array<torch::Tensor, 5> taps;
  torch::Tensor x = stem->forward(rgb);
  for (std::size_t i = 0; i < taps.size(); ++i) {
    for (const auto& block : *stages[i]->as<nn::ModuleList>()) {
      auto* vit = block->as<MobileVitBlock>();
      x = vit != nullptr ? vit->forward(x) : block->as<InvertedResidual>()->forward(x);
    }
    taps[i] = x;
  }
  taps[4] = final_conv->forward(x);
  return taps;
}

DecoderImpl::DecoderImpl(const ModelConfig& config, const std::array<int, 5>& taps)
    : bilinear(config.preset == PresetKind::kLcdm) {
  const bool reflect = !bilinear;
  int in = taps[4];
  for (std::size_t i = 5; i-- > 0;) {
    const int width = config.decoder_widths[i];
    const std::string name = "upconv_" + std::to_string(i);
    upconv[i][0] = register_module(name + "_0", keep_variance(conv3x3(in, width, reflect)));
    const int skip = i > 0 ? taps[i - 1] : 0;
    upconv[i][1] =
        register_module(name + "_1", keep_variance(conv3x3(width + skip, width, reflect)));
    in = width;
  }
  condition =
      register_module("condition", keep_variance(conv3x3(in, config.condition_channels, reflect)));
}

torch::Tensor DecoderImpl::forward(const std::array<torch::Tensor, 5>& taps) {
  torch::Tensor x = taps[4];
  for (std::size_t i = 5; i-- > 0;) {
    x = torch::elu(upconv[i][0]->forward(x));
    if (bilinear) {
      x = resize_bilinear(x, x.size(2) * 2, x.size(3) * 2);
    } else {
      x = F::interpolate(x, F::InterpolateFuncOptions()
                                .scale_factor(std::vector<double>{2, 2})
                                .mode(torch::kNearest));
    }
    if (i > 0) x = torch::cat({x, taps[i - 1]}, 1);
    x = torch::elu(upconv[i][1]->forward(x));
  }
  return torch::elu(condition->forward(x));
}

HeadImpl::HeadImpl(const ModelConfig& config) {
  const int c = config.condition_channels;
  const std::size_t steps = config.steps.size();
  embed = register_module("embed", conv3x3(1, c));
  time_embed =
      register_parameter("time_embed", torch::randn({ModelConfig::kDiffusionSteps, c}) * 0.1);
  conv1 = register_module("conv1", conv3x3(c, c));
  if (config.preset == PresetKind::kLcdm) {
    nn::ModuleList norms;
    for (std::size_t k = 0; k < steps; ++k) {
      norm.emplace_back(c);
      norms->push_back(norm.back());
    }
    register_module("norm", norms);
  } else {
    group_norm =
        register_module("norm", nn::GroupNorm(nn::GroupNormOptions(kGroups, c).eps(kNormEpsilon)));
  }
  conv2 = register_module("conv2", conv3x3(c, 1));
}

torch::Tensor HeadImpl::hidden(const torch::Tensor& condition, const torch::Tensor& x,
                               const torch::Tensor& times, int step, Statistics statistics) {
  const torch::Tensor time = time_embed.index_select(0, times).unsqueeze(-1).unsqueeze(-1);
  const torch::Tensor fused = condition + time + embed->forward(x);
  const torch::Tensor y = conv1->forward(fused);
  if (norm.empty()) return torch::relu(group_norm->forward(y));
  Norm& bn = norm[static_cast<std::size_t>(step)];
  if (statistics == Statistics::kUpdate || !bn->is_training()) return torch::relu(bn->forward(y));
  return torch::relu(bn->forward_without_trace(y));
}

torch::Tensor HeadImpl::forward(const torch::Tensor& condition, const torch::Tensor& x,
                                const torch::Tensor& times, int step, Statistics statistics) {
  return conv2->forward(hidden(condition, x, times, step, statistics));
}

DepthNetworkImpl::DepthNetworkImpl(const ModelConfig& model) : config(model) {
  encoder = register_module("encoder", MobileVit(config.encoder));
  decoder = register_module("decoder", Decoder(config, encoder->channels));
  head = register_module("head", Head(config));
  direct = register_module("direct", conv3x3(config.condition_channels, 1));
}

torch::Tensor DepthNetworkImpl::condition_of(const torch::Tensor& rgb) {
  if (!mixed_precision) return decoder->forward(encoder->forward(rgb));
  const Autocast autocast(rgb.device().type());
  return decoder->forward(encoder->forward(rgb)).to(torch::kFloat32);
}

torch::Tensor DepthNetworkImpl::start(int height, int width) {
  torch::Tensor x = torch::zeros({1, 1, height, width});
  if (config.start == StartKind::kNoise) {
    fill_gaussian(config.seed, {x.data_ptr<float>(), static_cast<std::size_t>(height) *
                                                         static_cast<std::size_t>(width)});
  }
  return x.to(direct->weight.device());
}

int DepthNetworkImpl::step_of(int t) const {
  int best = 0;
  for (std::size_t k = 1; k < config.steps.size(); ++k) {
    if (std::abs(config.steps[k] - t) <
        std::abs(config.steps[static_cast<std::size_t>(best)] - t)) {
      best = static_cast<int>(k);
    }
  }
  return best;
}

torch::Tensor DepthNetworkImpl::sample(const torch::Tensor& condition, int steps) {
  if (steps == 0) return direct->forward(condition);
  ModelConfig schedule = config;
  if (steps != static_cast<int>(config.steps.size())) {
    schedule.steps = sampler_times(config.preset, steps);
  }
  torch::Tensor x = start(static_cast<int>(condition.size(2)), static_cast<int>(condition.size(3)))
                        .expand({condition.size(0), -1, -1, -1});
  for (const SamplerStep& step : make_sampler(schedule)) {
    const torch::Tensor times =
        torch::full({condition.size(0)}, step.time, condition.options().dtype(torch::kLong));
    const torch::Tensor out =
        head->forward(condition, x, times, step_of(step.time), Statistics::kUpdate);
    x = x * step.p + out * step.q;
  }
  return x;
}

void measure_statistics(DepthNetwork& network, torch::nn::Module& part, Answers answers,
                        const std::vector<torch::Tensor>& pictures) {
  const torch::NoGradGuard no_grad;
  const bool was_training = network->is_training();
  const auto set = [&](double adopts) {
    for (const auto& module : part.modules()) {
      auto* norm = module->as<Norm>();
      if (norm == nullptr) continue;
      norm->adopts = adopts;
      norm->keeps_answers = answers == Answers::kKeep;
    }
  };
  network->eval();
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    set(1.0 / static_cast<double>(i + 1));
    network->sample(network->condition_of(pictures[i]),
                    static_cast<int>(network->config.steps.size()));
  }
  set(0);
  network->train(was_training);
}

}  // namespace lcdm::model
