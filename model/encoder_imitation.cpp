#include "model/encoder_imitation.h"

#include <cmath>

#include "model/optimizer.h"
#include "model/recipe.h"

namespace lcdm::model {
namespace {

// silu(kGain x) / kGain is much like relu(x): what comes out of an activation here is kGain times
// METER's.
constexpr double kGain = 2;
constexpr std::array<double, 5> kTapGains = {kGain, 1, kGain, kGain, kGain};

// Of weights that METER does not have: there from the start, but hardly heard.
constexpr double kFaint = 0.1;

// How many times METER's the layer's input and output are.
struct Gains {
  double in, out;
};

double root_mean_square(const torch::Tensor& x) { return x.square().mean().sqrt().item<double>(); }

// The filters as large as new ones, which suits the learning rate; the norm undoes that. The first
// outputs of the layer are METER's.
void put(const torch::Tensor& weight, const torch::Tensor& bias, Gains gains, ConvNorm& layer) {
  torch::Tensor& filters = layer->conv->weight;
  const double larger = root_mean_square(filters) / std::max(root_mean_square(weight), 1e-6);
  const std::int64_t outputs = weight.size(0);
  filters.narrow(0, 0, outputs).copy_(weight * larger);
  layer->bn->weight.narrow(0, 0, outputs)
      .fill_(gains.out / gains.in / larger * std::sqrt(1 + layer->bn->options.eps()));
  layer->bn->bias.narrow(0, 0, outputs).copy_(bias * gains.out);
}

void put(const MeterConvolution& conv, Gains gains, ConvNorm& layer) {
  put(conv.weight, conv.bias, gains, layer);
}

void put_stem(const MeterEncoder& meter, ConvNorm& stem) {
  const torch::Tensor& weight = meter.stem.weight;
  // Our grey is not METER's.
  const torch::Tensor grey =
      scale_pixels(by_channel(kOurPixels.mean, weight), meter.pixels).squeeze();
  const torch::Tensor spread =
      by_channel(kOurPixels.deviation, weight) / by_channel(meter.pixels.deviation, weight);
  put(weight * spread, meter.stem.bias + torch::matmul(weight.sum({2, 3}), grey), {1, kGain}, stem);
}

void put(const MeterInvertedResidual& from, Gains gains, InvertedResidual& to) {
  put(from.expand, {gains.in, kGain}, to->conv1_1x1);
  put(from.depthwise, {kGain, kGain}, to->conv2_kxk);
  put(from.project, {kGain, gains.out}, to->conv3_1x1);
}

void put(const MeterNorm& from, torch::nn::LayerNorm& to) {
  to->weight.copy_(from.weight);
  to->bias.copy_(from.bias);
}

// METER's channels first in every head; the further ones hardly change its scores.
void put_attention(const MeterVitBlock& from, Attention& to) {
  constexpr std::int64_t kTheirs = MeterVitBlock::kHeadDim;
  const std::int64_t dim = to->proj->weight.size(0);
  const std::int64_t ours = dim / kHeads;
  // Scores are divided by the root of a head's width: queries and keys make up for it by halves.
  const double wider = std::pow(static_cast<double>(ours) / static_cast<double>(kTheirs), 0.25);
  to->qkv->bias.zero_();
  to->proj->bias.copy_(from.proj_bias);
  for (std::int64_t head = 0; head < kHeads; ++head) {
    for (std::int64_t part = 0; part < 3; ++part) {  // queries, keys, values
      const torch::Tensor rows = from.qkv.t().narrow(0, (part * kHeads + head) * kTheirs, kTheirs);
      torch::Tensor place = to->qkv->weight.narrow(0, part * dim + head * ours, ours);
      place.narrow(0, 0, kTheirs).copy_(part < 2 ? rows * wider : rows);
      if (part == 0) place.narrow(0, kTheirs, ours - kTheirs).mul_(kFaint);
    }
    torch::Tensor columns = to->proj->weight.narrow(1, head * ours, ours);
    columns.narrow(1, 0, kTheirs).copy_(from.proj.t().narrow(1, head * kTheirs, kTheirs));
    columns.narrow(1, kTheirs, ours - kTheirs).mul_(kFaint);
  }
}

// The hidden channels that say most.
void put_feed_forward(const MeterVitBlock& from, FeedForward& to) {
  const torch::Tensor share = from.fc1.norm(2, {0}) * from.fc2.norm(2, {1});
  const torch::Tensor most =
      share.argsort(0, /*descending=*/true).narrow(0, 0, to->fc1->weight.size(0));
  to->fc1->weight.copy_(from.fc1.t().index_select(0, most) * kGain);
  to->fc1->bias.copy_(from.fc1_bias.index_select(0, most) * kGain);
  to->fc2->weight.copy_(from.fc2.t().index_select(1, most) / kGain);
  to->fc2->bias.copy_(from.fc2_bias);
}

void quieten(Transformer& transformer) {
  transformer->attn->proj->weight.mul_(kFaint);
  transformer->attn->proj->bias.zero_();
  transformer->mlp->fc2->weight.mul_(kFaint);
  transformer->mlp->fc2->bias.zero_();
}

void put(const MeterVitBlock& from, MobileVitBlock& to) {
  put(from.conv_kxk, {1, kGain}, to->conv_kxk);
  to->conv_1x1->weight.copy_(from.conv_1x1.weight / kGain);
  for (std::size_t i = 0; i < to->transformer->size(); ++i) {
    Transformer ours(std::dynamic_pointer_cast<TransformerImpl>(to->transformer->ptr(i)));
    if (i > 0) {
      quieten(ours);
      continue;
    }
    put(from.norm1, ours->norm1);
    put_attention(from, ours->attn);
    put(from.norm2, ours->norm2);
    put_feed_forward(from, ours->mlp);
  }
  put(from.conv_proj, {1, kGain}, to->conv_proj);
  // METER has what the transformer saw first, we have the input first, which is METER's once.
  const std::int64_t channels = from.fusion.weight.size(0);
  const auto halves = from.fusion.weight.split(channels, 1);
  put(torch::cat({halves[1], halves[0] / kGain}, 1), from.fusion.bias, {1, kGain}, to->conv_fusion);
}

// A layer of `encoder`, by its stage and its place there.
template <typename Block>
Block block_of(const MobileVit& encoder, std::size_t stage, std::size_t place) {
  const auto* blocks = encoder->stages->ptr(stage)->as<torch::nn::ModuleList>();
  return Block(std::dynamic_pointer_cast<typename Block::ContainedType>(blocks->ptr(place)));
}

}  // namespace

void start_as(const MeterEncoder& meter, MobileVit& encoder) {
  const torch::NoGradGuard no_grad;
  put_stem(meter, encoder->stem);
  const auto put_residual = [&](std::size_t number, std::size_t stage, std::size_t place,
                                Gains gains) {
    auto ours = block_of<InvertedResidual>(encoder, stage, place);
    put(meter.residuals[number], gains, ours);
  };
  put_residual(0, 0, 0, {kGain, kGain});
  put_residual(1, 1, 0, {kGain, 1});
  put_residual(2, 1, 1, {1, 1});
  put_residual(3, 1, 2, {1, 1});
  for (std::size_t i = 0; i < meter.blocks.size(); ++i) {
    put_residual(4 + i, 2 + i, 0, {i == 0 ? 1 : kGain, 1});
    auto ours = block_of<MobileVitBlock>(encoder, 2 + i, 1);
    put(meter.blocks[i], ours);
  }
  put(meter.final_conv, {kGain, kGain}, encoder->final_conv);
}

std::array<torch::Tensor, 5> imitation_errors(const MeterEncoder& meter, MobileVit& encoder,
                                              const torch::Tensor& rgb) {
  std::array<torch::Tensor, 5> wanted;
  {
    const torch::NoGradGuard no_grad;
    wanted = meter.forward(unit_pixels(rgb, kOurPixels)).taps;
  }
  const std::array<torch::Tensor, 5> taps = encoder->forward(rgb);
  std::array<torch::Tensor, 5> errors;
  for (std::size_t i = 0; i < taps.size(); ++i) {
    const torch::Tensor target = wanted[i] * kTapGains[i];
    const torch::Tensor ours = taps[i].narrow(1, 0, target.size(1));  // the last has more channels
    errors[i] = (ours - target).square().mean() / target.var().clamp_min(1e-6);
  }
  return errors;
}

Status imitate(const MeterEncoder& meter, DepthNetwork& network, BatchLoader& loader,
               std::int64_t steps,
               const std::function<void(std::int64_t step, const std::array<double, 5>&)>& report) {
  constexpr int kMeasured = 12;  // batches
  Recipe recipe;
  recipe.steps = steps;
  recipe.stages = {Stage()};
  recipe.learning_rate = 3e-4;
  recipe.final_rate = 0;
  recipe.warm_up = 30;
  // With the norms as METER's filters need them, not as batches would have them.
  network->eval();
  Optimizer optimizer(OptimizerKind::kAdamW, *network->encoder, /*weight_decay=*/0,
                      at::get_num_threads());
  DrawnFrames frames;
  for (std::int64_t step = 0; step < steps; ++step) {
    const Result<Batch> batch = loader.next();
    if (!batch) return batch.status();
    frames.add(*batch);
    LCDM_RETURN_IF_ERROR(frames.check());
    const auto errors = imitation_errors(meter, network->encoder, batch->rgb);
    network->zero_grad();
    torch::stack(std::vector<torch::Tensor>(errors.begin(), errors.end())).sum().backward();
    optimizer.step([&](const std::string&) { return learning_rate_at(recipe, step); });
    std::array<double, 5> numbers;
    for (std::size_t i = 0; i < errors.size(); ++i) numbers[i] = errors[i].item<double>();
    report(step, numbers);
  }
  std::vector<torch::Tensor> pictures;
  for (int i = 0; i < kMeasured; ++i) {
    const Result<Batch> batch = loader.next();
    if (!batch) return batch.status();
    pictures.push_back(batch->rgb);
  }
  measure_statistics(network, *network->encoder, Answers::kKeep, pictures);
  return Status::ok();
}

}  // namespace lcdm::model
