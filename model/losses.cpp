#include "model/losses.h"

#include "firmware/nn/sampler.h"
#include "model/depth_code.h"

namespace lcdm::model {
namespace {

using torch::indexing::Slice;

torch::Tensor per_image_sum(const torch::Tensor& x) { return x.flatten(1).sum(1); }

// Abar of every time, [150].
torch::Tensor abar_table(PresetKind preset) {
  const std::vector<double> abar = cumulative_alphas(preset);
  return torch::tensor(abar, torch::kFloat64).to(torch::kFloat32);
}

// Distillation in the preset's domain: log depth for `lcdm`, depth for `paper`.
torch::Tensor distillation_loss(const torch::Tensor& log_depth, const torch::Tensor& log_target,
                                const torch::Tensor& mask, const torch::Tensor& weight,
                                PresetKind preset) {
  if (preset == PresetKind::kLcdm) return log_depth_loss(log_depth, log_target, mask, weight);
  return masked_mean((log_depth.exp() - log_target.exp()).abs(), mask, weight);
}

}  // namespace

Losses Losses::times(double factor) const {
  return {total * factor, distillation * factor, denoising * factor, gradient * factor,
          direct * factor};
}

void Losses::add(const Losses& other) {
  total = total.detach() + other.total.detach();
  distillation += other.distillation;
  denoising += other.denoising;
  gradient += other.gradient;
  direct += other.direct;
}

torch::Tensor masked_mean(const torch::Tensor& error, const torch::Tensor& mask,
                          const torch::Tensor& weight) {
  const torch::Tensor count = per_image_sum(mask.to(error.dtype()));
  const torch::Tensor sum = per_image_sum(torch::where(mask, error, torch::zeros_like(error)));
  const torch::Tensor used = weight * (count > 0).to(weight.dtype());
  return (used * sum / count.clamp_min(1)).sum() / used.sum().clamp_min(1e-6);
}

torch::Tensor log_depth_loss(const torch::Tensor& log_depth, const torch::Tensor& log_target,
                             const torch::Tensor& mask, const torch::Tensor& weight) {
  const torch::Tensor error =
      torch::where(mask, log_depth - log_target, torch::zeros_like(log_depth));
  const torch::Tensor count = per_image_sum(mask.to(error.dtype())).clamp_min(1);
  const torch::Tensor scale = (per_image_sum(error) / count).reshape({-1, 1, 1, 1});
  const torch::Tensor shape = masked_mean((error - scale).abs(), mask, weight);
  return shape + kScaleWeight * masked_mean(scale.abs().expand_as(error), mask, weight);
}

torch::Tensor gradient_loss(const torch::Tensor& log_depth, const torch::Tensor& log_target,
                            const torch::Tensor& mask, const torch::Tensor& weight) {
  constexpr int kScales = 4;
  torch::Tensor total = torch::zeros({}, log_depth.options());
  for (int scale = 0; scale < kScales; ++scale) {
    const Slice every(torch::indexing::None, torch::indexing::None, 1 << scale);
    const torch::Tensor m = mask.index({Slice(), Slice(), every, every});
    const torch::Tensor difference =
        (log_depth - log_target).index({Slice(), Slice(), every, every});
    const torch::Tensor error =
        torch::where(m, difference, torch::zeros_like(difference));  // no NaN from holes
    for (const int axis : {2, 3}) {
      const std::int64_t n = error.size(axis) - 1;
      const torch::Tensor both = torch::logical_and(m.narrow(axis, 1, n), m.narrow(axis, 0, n));
      const torch::Tensor step = error.narrow(axis, 1, n) - error.narrow(axis, 0, n);
      total = total + masked_mean(step.abs(), both, weight);
    }
  }
  return total / kScales;
}

torch::Tensor align_to_student(const torch::Tensor& log_target, const torch::Tensor& log_depth,
                               const torch::Tensor& mask, const torch::Tensor& reliable) {
  const torch::NoGradGuard no_grad;
  torch::Tensor out = log_target.clone();
  for (std::int64_t b = 0; b < out.size(0); ++b) {
    if (reliable[b].item<bool>()) continue;
    const torch::Tensor difference = (log_depth[b] - log_target[b]).masked_select(mask[b]);
    if (difference.numel() > 0) out[b] += difference.median();
  }
  return out;
}

DenoisingDraw draw_denoising(const DepthNetwork& network, at::Generator& generator,
                             c10::IntArrayRef shape) {
  const auto& steps = network->config.steps;
  DenoisingDraw draw;
  draw.step = static_cast<int>(
      torch::randint(static_cast<std::int64_t>(steps.size()), {1}, generator).item<std::int64_t>());
  std::vector<std::int64_t> mine;
  for (int t = 0; t < ModelConfig::kDiffusionSteps; ++t) {
    if (network->step_of(t) == draw.step) mine.push_back(t);
  }
  const torch::Tensor pick =
      torch::randint(static_cast<std::int64_t>(mine.size()), {shape[0]}, generator, torch::kLong);
  draw.times = torch::tensor(mine, torch::kLong).index_select(0, pick);
  draw.noise = torch::randn(shape, generator);
  return draw;
}

torch::Tensor denoising_loss(DepthNetwork& network, const torch::Tensor& condition,
                             const torch::Tensor& target, const torch::Tensor& student,
                             const torch::Tensor& mask, const torch::Tensor& weight,
                             const DenoisingDraw& draw) {
  const PresetKind preset = network->config.preset;
  const torch::Tensor a = abar_table(preset).index_select(0, draw.times).reshape({-1, 1, 1, 1});
  const torch::Tensor signal = a.sqrt();
  const torch::Tensor spread = (1 - a).sqrt();
  const torch::Tensor x0 = torch::where(mask, target, student.detach());
  const torch::Tensor x = signal * x0 + spread * draw.noise;
  const torch::Tensor wanted =
      preset == PresetKind::kLcdm ? signal * draw.noise - spread * x0 : draw.noise;
  const torch::Tensor out =
      network->head->forward(condition, x, draw.times, draw.step, Statistics::kLeave);
  return masked_mean((out - wanted).square(), mask, weight);
}

Losses training_losses(DepthNetwork& network, const torch::Tensor& rgb, const Target& target,
                       const LossWeights& weights, Part part, at::Generator& generator) {
  const ModelConfig& config = network->config;
  const torch::Tensor condition = network->condition_of(rgb);
  const int steps = part == Part::kWhole ? static_cast<int>(config.steps.size()) : 0;
  const torch::Tensor direct = network->sample(condition, 0);
  const torch::Tensor student = steps > 0 ? network->sample(condition, steps) : direct;

  const torch::Tensor mask = target.depth > 0;
  const torch::Tensor log_target =
      align_to_student(torch::where(mask, target.depth, torch::ones_like(target.depth))
                           .clamp(kMinDepth, kMaxDepth)
                           .log(),
                       log_depth_of_variable(student, config), mask, target.reliable);

  const auto distillation = [&](const torch::Tensor& variable) {
    return distillation_loss(log_depth_of_variable(variable, config), log_target, mask,
                             target.weight, config.preset);
  };
  const auto gradient = [&](const torch::Tensor& variable) {
    return gradient_loss(log_depth_of_variable(variable, config), log_target, mask,
                         target.weight * target.sharp);
  };
  const torch::Tensor zero_step =
      weights.distillation * distillation(direct) + weights.gradient * gradient(direct);
  if (part == Part::kDirect) return {zero_step, 0, 0, 0, zero_step.item<double>()};

  const torch::Tensor distilled = distillation(student);
  const torch::Tensor edges = gradient(student);
  const torch::Tensor denoised =
      denoising_loss(network, condition, variable_of_depth(log_target.exp(), config), student, mask,
                     target.weight, draw_denoising(network, generator, student.sizes()));
  const torch::Tensor total = weights.distillation * distilled + weights.denoising * denoised +
                              weights.gradient * edges + weights.direct * zero_step;
  return {total, distilled.item<double>(), denoised.item<double>(), edges.item<double>(),
          zero_step.item<double>()};
}

}  // namespace lcdm::model
