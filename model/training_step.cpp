#include "model/training_step.h"

#include "model/losses.h"

namespace lcdm::model {
namespace {

using torch::Tensor;

struct DepthLosses {
  Tensor distillation;
  Tensor gradient;
};

DepthLosses depth_losses(const DepthNet& net, const Tensor& variable, const Tensor& teacher,
                         const Tensor& valid) {
  const Tensor depth = net->to_depth(variable);
  const bool paper = net->config.preset == PresetKind::kPaper;
  return {paper ? depth_loss(depth, teacher, valid) : log_depth_loss(depth, teacher, valid),
          gradient_loss(depth, teacher, valid)};
}

}  // namespace

StepLosses training_losses(DepthNet& net, const Batch& batch, const LossWeights& weights,
                           torch::Generator generator) {
  const Tensor condition = net->condition(batch.image);
  const auto draw = [&] {
    return torch::randn(batch.depth.sizes(), generator, batch.depth.options());
  };
  const Tensor x0_hat = net->sample(condition, draw(), net->config.steps);

  // A pack of unreliable scale teaches shape only: its median follows the student's.
  Tensor teacher = batch.depth;
  Tensor valid = teacher > 0;
  if (!batch.reliable_scale.front()) {
    teacher = teacher * median_ratio(net->to_depth(x0_hat.detach()), teacher, valid);
  }
  valid = valid.logical_and(teacher < 100).logical_and(teacher > 0.1);

  // Where the teacher is silent the diffusion starts from the student's own answer, so that the
  // head sees no holes; the loss is masked there.
  const Tensor known = net->to_variable(torch::where(valid, teacher, torch::ones_like(teacher)));
  const Tensor x0 = torch::where(valid, known, x0_hat.detach());
  const Tensor t = torch::randint(0, ModelConfig::kDiffusionSteps, {x0.size(0)}, generator,
                                  torch::TensorOptions().dtype(torch::kLong));
  const Tensor noise = draw();
  const Tensor prediction = net->head(condition, net->add_noise(x0, noise, t), t);
  const Tensor denoising = denoising_loss(prediction, net->target(x0, noise, t), valid);

  const DepthLosses rollout = depth_losses(net, x0_hat, teacher, valid);
  const DepthLosses direct = depth_losses(net, net->direct_answer(condition), teacher, valid);
  const Tensor direct_total =
      weights.distillation * direct.distillation + weights.gradient * direct.gradient;

  StepLosses losses;
  losses.total = weights.denoising * denoising + weights.distillation * rollout.distillation +
                 weights.gradient * rollout.gradient + weights.direct * direct_total;
  losses.denoising = denoising.item<double>();
  losses.distillation = rollout.distillation.item<double>();
  losses.gradient = rollout.gradient.item<double>();
  losses.direct = direct.distillation.item<double>();
  return losses;
}

}  // namespace lcdm::model
