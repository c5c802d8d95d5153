#include "model/losses.h"

#include <cmath>

#include "firmware/nn/sampler.h"
#include "model/depth_code.h"
#include "model/pixel_scale.h"
#include "model/self_supervision.h"

namespace lcdm::model {
namespace {

using torch::indexing::Slice;

torch::Tensor per_image_sum(const torch::Tensor& x) { return x.flatten(1).sum(1); }

// Abar of every time, [150].
torch::Tensor abar_table(PresetKind preset, const torch::Device& device) {
  const std::vector<double> abar = cumulative_alphas(preset);
  return torch::tensor(abar, torch::kFloat64).to(torch::kFloat32).to(device);
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
  Losses out = *this;
  out.total = total * factor;
  for (double& term : out.terms) term *= factor;
  return out;
}

void Losses::add(const Losses& other) {
  total = total.detach().cpu() + other.total.detach().cpu();
  for (std::size_t i = 0; i < terms.size(); ++i) terms[i] += other.terms[i];
}

torch::Tensor masked_mean(const torch::Tensor& error, const torch::Tensor& mask,
                          const torch::Tensor& weight) {
  const torch::Tensor count = per_image_sum(mask.to(error.dtype()));
  const torch::Tensor sum = per_image_sum(torch::where(mask, error, torch::zeros_like(error)));
  return (weight * sum / count.clamp_min(1)).mean();
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

namespace {

constexpr double kMostBeyond = 0.05;  // of an affine fit's pixels
// Of inverse depth, its deviation over its mean: a flat student must not flatten its teacher.
constexpr double kLeastSpread = 0.25;
// How many deviations of the diffusion variable from its mean an aligned map's median may lie. A
// target that follows the student holds no scale: without ends it drifts away and becomes flat.
constexpr double kMostDeviations = 2;

// Scale and shift of inverse depth.
struct Line {
  double a, b;
};

// By means and deviations, not by least squares: those would shrink the map by how badly the two
// agree, and the student with it. No scale where near and far are swapped.
Line line_to(const torch::Tensor& teacher, const torch::Tensor& student) {
  const torch::Tensor x = teacher.to(torch::kFloat64);
  const torch::Tensor y = student.to(torch::kFloat64);
  const torch::Tensor dx = x - x.mean();
  const double spread = dx.square().mean().item<double>();
  const double mean = y.mean().item<double>();
  if (!(spread > 0) || (dx * y).mean().item<double>() < 0) return {0, mean};
  const double wanted =
      std::max((y - mean).square().mean().sqrt().item<double>(), kLeastSpread * mean);
  const double a = wanted / std::sqrt(spread);
  return {a, mean - a * x.mean().item<double>()};
}

// Inverse depth scaled and shifted; false where the fit turns near into far or leaves the range
// with more than a few pixels: a shift that is a little off costs the farthest ones, and no more.
bool align_affine(torch::Tensor log_target, const torch::Tensor& log_depth,
                  const torch::Tensor& mask) {
  const torch::Tensor teacher = torch::exp(-log_target);
  const Line line =
      line_to(teacher.masked_select(mask), torch::exp(-log_depth).masked_select(mask));
  const torch::Tensor inverse = teacher * line.a + line.b;
  const torch::Tensor beyond = (inverse < 1 / kMaxDepth).masked_select(mask);
  if (line.a <= 0 || beyond.to(torch::kFloat64).mean().item<double>() > kMostBeyond) return false;
  log_target.copy_(torch::where(mask, -inverse.clamp_min(1 / kMaxDepth).log(), log_target));
  return true;
}

// [N, 1, 1, 1]; 0 where nothing is known.
torch::Tensor medians(const torch::Tensor& values, const torch::Tensor& mask) {
  const torch::Tensor known = torch::where(mask, values, NAN).flatten(1);
  return std::get<0>(known.nanmedian(1)).nan_to_num().reshape({-1, 1, 1, 1});
}

}  // namespace

torch::Tensor align_to_student(const torch::Tensor& log_target, const torch::Tensor& log_depth,
                               const torch::Tensor& mask, const torch::Tensor& alignment,
                               const ModelConfig& config) {
  const torch::NoGradGuard no_grad;
  const torch::Tensor follows =
      (alignment != static_cast<std::int64_t>(Alignment::kNone)).reshape({-1, 1, 1, 1});
  torch::Tensor out =
      log_target + torch::where(follows, medians(log_depth - log_target, mask), 0.0);
  const torch::Tensor affine =
      (alignment == static_cast<std::int64_t>(Alignment::kAffine)).nonzero().cpu();
  for (std::int64_t i = 0; i < affine.size(0); ++i) {
    const std::int64_t b = affine[i].item<std::int64_t>();
    align_affine(out[b], log_depth[b], mask[b]);
  }
  const torch::Tensor middle = medians(out, mask);
  const torch::Tensor ends =
      log_depth_of_variable(torch::tensor({kMostDeviations, -kMostDeviations}), config);
  const torch::Tensor held = middle.clamp(ends[0].item<double>(), ends[1].item<double>());
  return out + torch::where(follows, held - middle, 0.0);
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
  // Drawn on the CPU, so that every device sees the same noise.
  const torch::Device device = network->direct->weight.device();
  draw.times = torch::tensor(mine, torch::kLong).index_select(0, pick).to(device);
  draw.noise = torch::randn(shape, generator).to(device);
  return draw;
}

torch::Tensor denoising_loss(DepthNetwork& network, const torch::Tensor& condition,
                             const torch::Tensor& target, const torch::Tensor& student,
                             const torch::Tensor& mask, const torch::Tensor& weight,
                             const DenoisingDraw& draw) {
  const PresetKind preset = network->config.preset;
  const torch::Tensor a =
      abar_table(preset, target.device()).index_select(0, draw.times).reshape({-1, 1, 1, 1});
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

torch::Tensor normal_loss(const torch::Tensor& depth, const torch::Tensor& target_depth,
                          const torch::Tensor& mask, const torch::Tensor& weight,
                          const Pinholes& cameras, PresetKind preset) {
  const int size = preset == PresetKind::kLcdm ? 5 : 9;
  const int dilation = preset == PresetKind::kLcdm ? 1 : 4;
  const Normals student = surface_normals(depth, mask, cameras, size, dilation);
  const Normals teacher = surface_normals(target_depth, mask, cameras, size, dilation);
  const torch::Tensor error = (student.direction - teacher.direction).square().sum(1, true);
  return masked_mean(error, teacher.valid, weight);
}

namespace {

// A wrong focal length must not be learned to please the normals.
Pinholes detached(const Pinholes& cameras) {
  return {cameras.fx.detach(), cameras.fy.detach(), cameras.cx, cameras.cy};
}

// How the camera moved to a picture and from there, as PoseNet sees it: at half size, because it is
// most of a step's cost otherwise.
struct Motions {
  Motion before, after;
};
Motions motions_of(PoseNet& pose, const Views& views) {
  const auto small = [](const torch::Tensor& picture) {
    return torch::avg_pool2d(scale_pixels(picture, kOurPixels), 2);
  };
  const torch::Tensor here = small(views.here);
  return {pose->forward(small(views.earlier), here), pose->forward(here, small(views.later))};
}

// The losses of estimates of the batch's depth.
class DepthLosses {
 public:
  DepthLosses(TrainedNetworks& networks, const Batch& batch, const LossWeights& weights,
              const torch::Tensor& log_target)
      : config_(networks->depth->config),
        batch_(batch),
        weights_(weights),
        cameras_(networks->cameras.is_empty()
                     ? batch.cameras
                     : networks->cameras->forward(batch.cameras, batch.learned_camera)),
        mask_(batch.target.depth > 0),
        log_target_(log_target) {
    if (weights.photometric > 0) motions_ = motions_of(networks->pose, batch.views);
  }

  // The weighted sum over `variable`; the terms are noted in `losses`.
  torch::Tensor of(const torch::Tensor& variable, Losses& losses, at::Generator& generator) const {
    const Target& target = batch_.target;
    const torch::Tensor log_depth = log_depth_of_variable(variable, config_);
    torch::Tensor total = torch::zeros({}, variable.options());
    const auto take = [&](Term term, double weight, const torch::Tensor& loss) {
      total = total + weight * loss;
      losses[term] = loss.item<double>();
    };
    take(Term::kDistillation, weights_.distillation,
         distillation_loss(log_depth, log_target_, mask_, target.weight, config_.preset));
    if (weights_.gradient > 0) {
      take(Term::kGradient, weights_.gradient,
           gradient_loss(log_depth, log_target_, mask_, target.weight * target.sharp));
    }
    if (weights_.normals > 0) {
      take(Term::kNormals, weights_.normals,
           normal_loss(log_depth.exp(), log_target_.exp(), mask_, target.weight, detached(cameras_),
                       config_.preset));
    }
    if (weights_.smoothness > 0) {
      take(Term::kSmoothness, weights_.smoothness,
           smoothness_loss(torch::exp(-log_depth), batch_.views.here));
    }
    if (weights_.photometric > 0) {
      take(Term::kPhotometric, weights_.photometric, photometric(log_depth.exp(), generator));
    }
    return total;
  }

 private:
  torch::Tensor photometric(const torch::Tensor& depth, at::Generator& generator) const {
    const Views& views = batch_.views;
    const torch::Tensor points = back_project(depth, cameras_);
    const auto seen = [&](const torch::Tensor& picture, const Motion& motion, bool inverse) {
      const torch::Tensor to = rigid_motion(motion.axis_angle, motion.translation, inverse);
      return sample_at(picture, project(points, to, cameras_));
    };
    return photometric_loss(
        views.here,
        {seen(views.earlier, motions_.before, true), seen(views.later, motions_.after, false)},
        {views.earlier, views.later}, views.present, generator);
  }

  const ModelConfig& config_;
  const Batch& batch_;
  const LossWeights& weights_;
  Pinholes cameras_;  // with gradients where they are learned
  torch::Tensor mask_;
  torch::Tensor log_target_;
  Motions motions_;
};

}  // namespace

Losses training_losses(TrainedNetworks& networks, const Batch& batch, const LossWeights& weights,
                       Part part, at::Generator& generator) {
  DepthNetwork& network = networks->depth;
  const ModelConfig& config = network->config;
  const Target& target = batch.target;
  const torch::Tensor condition = network->condition_of(batch.rgb);
  const int steps = part == Part::kWhole ? static_cast<int>(config.steps.size()) : 0;
  const torch::Tensor direct = network->sample(condition, 0);
  const torch::Tensor student = steps > 0 ? network->sample(condition, steps) : direct;

  const torch::Tensor mask = target.depth > 0;
  // What can be said is a matter of the aligned depth: a teacher's own metres may be of any size.
  const torch::Tensor log_target =
      align_to_student(torch::where(mask, target.depth, torch::ones_like(target.depth)).log(),
                       log_depth_of_variable(student, config), mask, target.alignment, config)
          .clamp(std::log(kMinDepth), std::log(kMaxDepth));
  const DepthLosses depth_losses(networks, batch, weights, log_target);

  Losses losses;
  if (part == Part::kDirect) {
    losses.total = depth_losses.of(direct, losses, generator);
    losses[Term::kDirect] = losses.total.item<double>();
    return losses;
  }
  const torch::Tensor denoised =
      denoising_loss(network, condition, variable_of_depth(log_target.exp(), config), student, mask,
                     target.weight, draw_denoising(network, generator, student.sizes()));
  const torch::Tensor rollout = depth_losses.of(student, losses, generator);
  Losses of_direct;
  const torch::Tensor zero_step = depth_losses.of(direct, of_direct, generator);
  losses[Term::kDenoising] = denoised.item<double>();
  losses[Term::kDirect] = zero_step.item<double>();
  losses.total = rollout + weights.denoising * denoised + weights.direct * zero_step;
  return losses;
}

}  // namespace lcdm::model
