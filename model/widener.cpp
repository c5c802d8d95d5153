#include "model/widener.h"

#include <cmath>
#include <map>
#include <string>
#include <vector>

#include "firmware/base/check.h"
#include "model/checkpoint.h"

namespace lcdm::model {
namespace {

using torch::indexing::Slice;

// Channels of the narrow layer, from `from` on, and where they stand in the wide one.
struct Channels {
  std::int64_t from, to, count;
};
using ChannelMap = std::vector<Channels>;

ChannelMap first(std::int64_t count) { return {{0, 0, count}}; }

// The narrow rows become the wide layer's at their places: they read the narrow columns at theirs,
// and 0 of all others.
void place(const torch::Tensor& narrow, torch::Tensor& wide, const ChannelMap& rows,
           const ChannelMap& columns) {
  for (const Channels& row : rows) {
    torch::Tensor to = wide.narrow(0, row.to, row.count);
    const torch::Tensor from = narrow.narrow(0, row.from, row.count);
    to.zero_();
    for (const Channels& column : columns) {
      to.narrow(1, column.to, column.count).copy_(from.narrow(1, column.from, column.count));
    }
  }
}

void place(const torch::Tensor& narrow, torch::Tensor& wide, const ChannelMap& rows) {
  for (const Channels& row : rows) {
    wide.narrow(0, row.to, row.count).copy_(narrow.narrow(0, row.from, row.count));
  }
}

void widen_norm(const Norm& narrow, Norm& wide) {
  const ChannelMap rows = first(narrow->weight.size(0));
  place(narrow->weight, wide->weight, rows);
  place(narrow->bias, wide->bias, rows);
  place(narrow->running_mean, wide->running_mean, rows);
  place(narrow->running_var, wide->running_var, rows);
}

void widen_conv(const ConvNorm& narrow, ConvNorm& wide, const ChannelMap& columns) {
  place(narrow->conv->weight, wide->conv->weight, first(narrow->conv->weight.size(0)), columns);
  widen_norm(narrow->bn, wide->bn);
}

void widen_conv(const ConvNorm& narrow, ConvNorm& wide) {
  widen_conv(narrow, wide, first(narrow->conv->weight.size(1)));
}

// The shortcut of the narrow block as channels of the wide one, which has none because it has more
// outputs than inputs: x + kLift goes through both SiLUs almost unchanged, and the projection takes
// kLift off again.
void carry_shortcut(std::int64_t hidden, InvertedResidual& wide) {
  constexpr double kLift = 8;
  const std::int64_t channels = wide->conv1_1x1->conv->weight.size(1);
  const auto carried = Slice(hidden, hidden + channels);
  const auto pass = [&](ConvNorm& block, const torch::Tensor& weight, double bias) {
    block->conv->weight.index_put_({carried}, weight);
    block->bn->running_mean.index_put_({carried}, 0);
    block->bn->running_var.index_put_({carried}, 1 - block->bn->options.eps());
    block->bn->weight.index_put_({carried}, 1);
    block->bn->bias.index_put_({carried}, bias);
  };
  pass(wide->conv1_1x1, torch::eye(channels).view({channels, channels, 1, 1}), kLift);
  torch::Tensor centre = torch::zeros({channels, 1, 3, 3});
  centre.index_put_({Slice(), 0, 1, 1}, 1);
  pass(wide->conv2_kxk, centre, 0);

  Norm& norm = wide->conv3_1x1->bn;
  const auto outputs = Slice(0, channels);
  const torch::Tensor scale =
      (norm->weight / (norm->running_var + norm->options.eps()).sqrt()).index({outputs});
  wide->conv3_1x1->conv->weight.index_put_({outputs, carried},
                                           torch::diag(1 / scale).view({channels, channels, 1, 1}));
  norm->bias.index({outputs}).sub_(kLift);
}

void widen_residual(const InvertedResidual& narrow, InvertedResidual& wide) {
  widen_conv(narrow->conv1_1x1, wide->conv1_1x1);
  widen_conv(narrow->conv2_kxk, wide->conv2_kxk);
  widen_conv(narrow->conv3_1x1, wide->conv3_1x1);
  if (narrow->residual && !wide->residual) {
    carry_shortcut(narrow->conv1_1x1->conv->weight.size(0), wide);
  }
}

// A layer that writes into the sum a transformer's layer norms look at. They take off the mean
// anyway: without it, the deviation of the longer sum is known.
torch::Tensor without_mean(const torch::Tensor& writer) { return writer - writer.mean(0); }

void widen_writer(const torch::Tensor& narrow, torch::Tensor& wide, const ChannelMap& columns) {
  wide.zero_();
  place(without_mean(narrow), wide, first(narrow.size(0)), columns);
}

void widen_bias_of_writer(const torch::Tensor& narrow, torch::Tensor& wide) {
  wide.zero_();
  place(without_mean(narrow), wide, first(narrow.size(0)));
}

// Of a sum whose new channels are 0.
void widen_layer_norm(const torch::nn::LayerNorm& narrow, torch::nn::LayerNorm& wide) {
  const ChannelMap rows = first(narrow->weight.size(0));
  const double share =
      static_cast<double>(narrow->weight.size(0)) / static_cast<double>(wide->weight.size(0));
  place(narrow->weight * std::sqrt(share), wide->weight, rows);
  place(narrow->bias, wide->bias, rows);
}

// Where each head's channels stand in one of q, k, v.
ChannelMap heads_of(std::int64_t narrow, std::int64_t wide, std::int64_t part) {
  ChannelMap map;
  for (std::int64_t head = 0; head < kHeads; ++head) {
    map.push_back({part * narrow + head * narrow / kHeads, part * wide + head * wide / kHeads,
                   narrow / kHeads});
  }
  return map;
}

void widen_attention(const Attention& narrow, Attention& wide) {
  const std::int64_t from = narrow->proj->weight.size(0);
  const std::int64_t to = wide->proj->weight.size(0);
  // New channels of the keys are 0: they add nothing to the scores.
  wide->qkv->weight.narrow(0, to, to).zero_();
  wide->qkv->bias.narrow(0, to, to).zero_();
  for (std::int64_t part = 0; part < 3; ++part) {
    // Scores are divided by the root of a head's width.
    const double scale =
        part == 0 ? std::sqrt(static_cast<double>(to) / static_cast<double>(from)) : 1;
    const ChannelMap rows = heads_of(from, to, part);
    place(narrow->qkv->weight * scale, wide->qkv->weight, rows, first(from));
    place(narrow->qkv->bias * scale, wide->qkv->bias, rows);
  }
  widen_writer(narrow->proj->weight, wide->proj->weight, heads_of(from, to, 0));
  widen_bias_of_writer(narrow->proj->bias, wide->proj->bias);
}

void widen_feed_forward(const FeedForward& narrow, FeedForward& wide) {
  const ChannelMap hidden = first(narrow->fc1->weight.size(0));
  place(narrow->fc1->weight, wide->fc1->weight, hidden, first(narrow->fc1->weight.size(1)));
  place(narrow->fc1->bias, wide->fc1->bias, hidden);
  widen_writer(narrow->fc2->weight, wide->fc2->weight, hidden);
  widen_bias_of_writer(narrow->fc2->bias, wide->fc2->bias);
}

void widen_block(const MobileVitBlock& narrow, MobileVitBlock& wide) {
  widen_conv(narrow->conv_kxk, wide->conv_kxk);
  widen_writer(narrow->conv_1x1->weight, wide->conv_1x1->weight,
               first(narrow->conv_1x1->weight.size(1)));
  for (std::size_t i = 0; i < narrow->transformer->size(); ++i) {
    const auto from = std::dynamic_pointer_cast<TransformerImpl>(narrow->transformer->ptr(i));
    const auto to = std::dynamic_pointer_cast<TransformerImpl>(wide->transformer->ptr(i));
    widen_layer_norm(from->norm1, to->norm1);
    widen_attention(from->attn, to->attn);
    widen_layer_norm(from->norm2, to->norm2);
    widen_feed_forward(from->mlp, to->mlp);
  }
  widen_layer_norm(narrow->norm, wide->norm);
  widen_conv(narrow->conv_proj, wide->conv_proj);
  const std::int64_t from = narrow->conv_fusion->conv->weight.size(0);
  const std::int64_t to = wide->conv_fusion->conv->weight.size(0);
  widen_conv(narrow->conv_fusion, wide->conv_fusion, {{0, 0, from}, {from, to, from}});
}

void widen_encoder(const MobileVit& narrow, MobileVit& wide) {
  widen_conv(narrow->stem, wide->stem);
  for (std::size_t i = 0; i < narrow->stages->size(); ++i) {
    const auto* from = narrow->stages->ptr(i)->as<torch::nn::ModuleList>();
    const auto* to = wide->stages->ptr(i)->as<torch::nn::ModuleList>();
    for (std::size_t j = 0; j < from->size(); ++j) {
      if (auto vit = std::dynamic_pointer_cast<MobileVitBlockImpl>(from->ptr(j))) {
        MobileVitBlock block(std::dynamic_pointer_cast<MobileVitBlockImpl>(to->ptr(j)));
        widen_block(MobileVitBlock(vit), block);
      } else {
        InvertedResidual block(std::dynamic_pointer_cast<InvertedResidualImpl>(to->ptr(j)));
        widen_residual(
            InvertedResidual(std::dynamic_pointer_cast<InvertedResidualImpl>(from->ptr(j))), block);
      }
    }
  }
  widen_conv(narrow->final_conv, wide->final_conv);
}

// Only what it reads of the encoder is wider: the last columns of its first convolutions.
void widen_decoder(const Decoder& narrow, Decoder& wide) {
  const auto from = narrow->named_parameters();
  for (auto& item : wide->named_parameters()) {
    const torch::Tensor& values = from[item.key()];
    const ChannelMap rows = first(values.size(0));
    if (values.dim() == 1) {
      place(values, item.value(), rows);
    } else {
      place(values, item.value(), rows, first(values.size(1)));
    }
  }
}

void copy_all(const torch::nn::Module& from, torch::nn::Module& to) {
  std::map<std::string, torch::Tensor> tensors;
  collect(from, "", tensors);
  LCDM_CHECK(restore(to, "", tensors));  // fits() looked at all that decides their shapes
}

bool fits(const ModelConfig& narrow, const ModelConfig& wide) {
  return narrow.preset == wide.preset && narrow.decoder_widths == wide.decoder_widths &&
         narrow.condition_channels == wide.condition_channels &&
         narrow.steps.size() == wide.steps.size() && narrow.encoder < wide.encoder;
}

}  // namespace

Status widen(const DepthNetwork& narrow, DepthNetwork& wide) {
  if (!fits(narrow->config, wide->config)) {
    return Status::error(StatusCode::kInvalidInput,
                         "the weights to start from are of another preset, of other widths, of "
                         "another number of sampling steps, or of a larger encoder than the "
                         "recipe's");
  }
  const torch::NoGradGuard no_grad;
  widen_encoder(narrow->encoder, wide->encoder);
  widen_decoder(narrow->decoder, wide->decoder);
  copy_all(*narrow->head, *wide->head);
  copy_all(*narrow->direct, *wide->direct);
  return Status::ok();
}

}  // namespace lcdm::model
