#include "model/losses.h"

namespace lcdm::model {

using torch::Tensor;

Tensor masked_mean(const Tensor& value, const Tensor& valid) {
  // where, not a product: a NaN in a masked pixel must not survive.
  const Tensor kept = torch::where(valid, value, torch::zeros_like(value));
  return kept.sum() / valid.sum().clamp_min(1);
}

Tensor denoising_loss(const Tensor& prediction, const Tensor& target, const Tensor& valid) {
  return masked_mean((prediction - target).square(), valid);
}

Tensor log_depth_loss(const Tensor& depth, const Tensor& teacher, const Tensor& valid) {
  const Tensor safe = torch::where(valid, teacher, torch::ones_like(teacher));
  return masked_mean((depth.log() - safe.log()).abs(), valid);
}

Tensor depth_loss(const Tensor& depth, const Tensor& teacher, const Tensor& valid) {
  return masked_mean((depth - teacher).abs(), valid);
}

Tensor gradient_loss(const Tensor& depth, const Tensor& teacher, const Tensor& valid) {
  const Tensor safe = torch::where(valid, teacher, torch::ones_like(teacher));
  Tensor difference = torch::where(valid, depth.log() - safe.log(), torch::zeros_like(depth));
  Tensor mask = valid;
  Tensor total = torch::zeros({}, depth.options());
  constexpr int kScales = 4;
  using torch::indexing::None;
  using torch::indexing::Slice;
  for (int scale = 0; scale < kScales; ++scale) {
    const auto along = [&](int dimension) {
      const int64_t n = difference.size(dimension);
      const Tensor step = difference.slice(dimension, 1, n) - difference.slice(dimension, 0, n - 1);
      const Tensor both = mask.slice(dimension, 1, n).logical_and(mask.slice(dimension, 0, n - 1));
      return masked_mean(step.abs(), both);
    };
    total = total + along(2) + along(3);
    difference = difference.index({Slice(), Slice(), Slice(None, None, 2), Slice(None, None, 2)});
    mask = mask.index({Slice(), Slice(), Slice(None, None, 2), Slice(None, None, 2)});
  }
  return total / kScales;
}

Tensor median_ratio(const Tensor& student, const Tensor& teacher, const Tensor& valid) {
  const torch::NoGradGuard no_grad;
  Tensor ratio = torch::ones({student.size(0), 1, 1, 1}, student.options());
  for (int64_t i = 0; i < student.size(0); ++i) {
    if (valid[i].sum().item<int64_t>() == 0) continue;
    const Tensor s = student[i].masked_select(valid[i]).median();
    const Tensor t = teacher[i].masked_select(valid[i]).median();
    ratio[i][0][0][0] = s / t;
  }
  return ratio;
}

}  // namespace lcdm::model
