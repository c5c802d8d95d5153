#include "model/training_samples.h"

#include <algorithm>
#include <cmath>

#include "model/depth_code.h"

namespace lcdm::model {
namespace {

// How many pictures of a deployed size have the pixels of one of the largest.
int pictures_for_one(int width, int height) {
  int most = 0;
  for (const auto& [w, h] : kDeployed) most = std::max(most, w * h);
  return most / (width * height);
}

}  // namespace

bool is_drawn(const std::vector<Pack>& packs, bool wide) {
  return std::any_of(packs.begin(), packs.end(), [wide](const Pack& pack) {
    return !pack.train.empty() && (wide ? pack.use.wide_share : pack.use.tall_share) > 0;
  });
}

std::vector<BatchShape> make_shapes(const Recipe& recipe, const Stage& stage, int rank,
                                    const std::vector<Pack>& packs) {
  std::vector<BatchShape> shapes;
  for (const auto& [width, height] : kDeployed) {
    BatchShape shape;
    shape.width = scaled_side(width, stage.share);
    shape.height = scaled_side(height, stage.share);
    shape.squeeze = static_cast<double>(width) / height * shape.height / shape.width;
    shape.canonical_focal =
        kCanonicalFocal * static_cast<float>(shape.width) / static_cast<float>(width);
    shape.images = stage.images * pictures_for_one(width, height);
    shape.first = rank * shape.images;
    shape.wide = width > 2 * height;
    shape.views = recipe.losses.photometric > 0 || recipe.losses.smoothness > 0;
    if (is_drawn(packs, shape.wide)) shapes.push_back(shape);
  }
  return shapes;
}

Result<std::vector<Batch>> make_samples(const Recipe& recipe, Stage stage,
                                        const std::vector<Pack>& packs) {
  constexpr std::uint64_t kBatches = 16;
  stage.images = 8;
  const std::vector<BatchShape> shapes = make_shapes(recipe, stage, 0, packs);
  std::vector<Batch> batches;
  for (std::uint64_t i = 0; i < kBatches; ++i) {
    Result<Batch> batch = make_batch(packs, shapes[i % shapes.size()], ~recipe.seed, i);
    if (!batch) return batch.status();
    batches.push_back(std::move(*batch));
  }
  return batches;
}

void measure_variable(ModelConfig& config, const std::vector<Batch>& samples) {
  std::vector<torch::Tensor> logits;
  for (const Batch& batch : samples) {
    const torch::Tensor& depth = batch.target.depth;
    logits.push_back(variable_of_depth(depth.masked_select(depth > 0), ModelConfig{}));
  }
  const torch::Tensor all = torch::cat(logits);
  if (all.numel() < 2) return;  // photometric loss alone
  config.variable_mean = std::round(all.mean().item<double>() * 1e4) / 1e4;
  config.variable_std = std::round(all.std().item<double>() * 1e4) / 1e4;
}

Status check_teachers(const Recipe& recipe, const std::vector<Batch>& samples) {
  const bool taught = std::any_of(samples.begin(), samples.end(), [](const Batch& batch) {
    return (batch.target.depth > 0).any().item<bool>();
  });
  if (taught || recipe.losses.photometric > 0) return Status::ok();
  return Status::error(StatusCode::kInvalidInput,
                       "nothing to learn from: no picture of %zu batches drawn has any depth, and "
                       "the photometric loss has no weight: give depth or a teacher's maps, or to "
                       "a video --photometric 1",
                       samples.size());
}

Status check_shares(const std::vector<Pack>& packs) {
  if (is_drawn(packs, true) || is_drawn(packs, false)) return Status::ok();
  return Status::error(StatusCode::kInvalidInput,
                       "no picture to train on: give a set of the catalogue a wide-share or a "
                       "tall-share");
}

Status check_neighbours(const std::vector<Pack>& packs) {
  for (const Pack& pack : packs) {
    if (pack.use.wide_share + pack.use.tall_share <= 0) continue;
    for (const std::size_t index : pack.train) {
      if (pack.frames->has_neighbours(index)) return Status::ok();
    }
  }
  return Status::error(StatusCode::kInvalidInput,
                       "the photometric loss needs neighbours in time, and no picture to train on "
                       "has any: give video = true to a set of the catalogue, --video to packs of "
                       "your own, or the loss no weight (--photometric 0)");
}

Status check_no_learned_cameras(const std::vector<Pack>& packs) {
  for (const Pack& pack : packs) {
    if (!pack.use.learn_intrinsics) continue;
    return Status::error(StatusCode::kInvalidInput,
                         "%s: focal lengths are learned by the photometric loss alone: give "
                         "--photometric a weight, or the set no learn-intrinsics",
                         pack.use.name.c_str());
  }
  return Status::ok();
}

}  // namespace lcdm::model
