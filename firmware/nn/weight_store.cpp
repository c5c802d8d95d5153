#include "firmware/nn/weight_store.h"

#include <algorithm>

#include "firmware/nn/kernels/inverted_residual.h"
#include "firmware/nn/kernels/row_winograd.h"

namespace lcdm {
namespace {

// Upsampled shares to as few channels as this are floats beside bfloat16: they are hardly any
// multiply-adds, and eight bits of their weights shift the depth of whole frames (XS at 640x192 by
// .018 in one scene of twelve).
constexpr int kFewColumns = 32;

// A 3x3 weight [columns, channels, 3, 3], of which the channels from `first` on are meant.
struct Filters {
  std::vector<float> values;
  int channels = 0;
  int first = 0;

  float at(int c, int n, int tap) const {
    const int filter = n * channels + first + c;
    return values[static_cast<std::size_t>(filter) * 9 + static_cast<std::size_t>(tap)];
  }
};

int input_channels(const Layer& layer) { return static_cast<int>(layer.parameters[0].shape[1]); }

// conv1 of embed's taps and of the time, with the scale, as a 5x5 convolution and a constant for
// each place of a pixel.
struct ComposedHead {
  std::vector<float> composed;  // [kHeadPlaces, 25, channels]
  std::vector<float> constant;  // [kHeadPlaces, channels]
};
struct HeadParameters {
  std::vector<float> embed, time, conv1, scale, bias;
};

// The output channel n of it at one place.
void compose(const HeadParameters& p, std::size_t place, std::size_t n, ComposedHead& out) {
  const std::size_t channels = p.scale.size();
  double taps[25] = {};
  auto constant = static_cast<double>(p.bias[n]);
  for (std::size_t c = 0; c < channels; ++c) {
    for (std::size_t t = 0; t < 9; ++t) {
      if (!kernels::head_tap_sees(place, t)) continue;
      const float weight = p.conv1[(n * channels + c) * 9 + t];
      const double scaled = static_cast<double>(p.scale[n]) * static_cast<double>(weight);
      constant += scaled * static_cast<double>(p.time[c]);
      for (std::size_t e = 0; e < 9; ++e) {
        const std::size_t at = 5 * (t / 3 + e / 3) + t % 3 + e % 3;
        taps[at] += scaled * static_cast<double>(p.embed[c * 9 + e]);
      }
    }
  }
  out.constant[place * channels + n] = static_cast<float>(constant);
  for (std::size_t i = 0; i < 25; ++i) {
    out.composed[(place * 25 + i) * channels + n] = static_cast<float>(taps[i]);
  }
}

ComposedHead compose(const HeadParameters& p) {
  const std::size_t channels = p.scale.size();
  ComposedHead out{std::vector<float>(channels * 25 * kernels::kHeadPlaces),
                   std::vector<float>(channels * kernels::kHeadPlaces)};
  for (std::size_t place = 0; place < kernels::kHeadPlaces; ++place) {
    for (std::size_t n = 0; n < channels; ++n) compose(p, place, n, out);
  }
  return out;
}

}  // namespace

Precision WeightStore::precision_for(int numbers, Precision narrowest, int runs) const {
  return kernels::native_precision(std::min(precision_, narrowest), numbers, runs);
}

Precision WeightStore::head_precision(int channels) const {
  return kernels::head_precision(precision_, channels);
}

Precision WeightStore::filter_precision() const {
  const Precision halves = precision_for(2, Precision::kBfloat16);
  return halves == Precision::kBfloat16 ? halves : Precision::kFloat32;
}

std::vector<float> WeightStore::load(const Parameter& parameter) const {
  const auto found = model_.tensors().find(parameter.name);
  LCDM_CHECK(found != model_.tensors().end());  // check_weights has seen it
  std::vector<float> values(found->second.count);
  model_.read(found->second, values);
  return values;
}

std::vector<float> WeightStore::load_taps(const Parameter& parameter) const {
  const std::vector<float> values = load(parameter);
  const std::size_t channels = values.size() / 9;
  std::vector<float> taps(values.size());
  for (std::size_t c = 0; c < channels; ++c) {
    for (std::size_t t = 0; t < 9; ++t) taps[t * channels + c] = values[c * 9 + t];
  }
  return taps;
}

// Empty where the layer has none.
std::vector<float> WeightStore::bias_of(const Layer& layer) const {
  return layer.parameters.size() > 1 ? load(layer.parameters[1]) : std::vector<float>{};
}

Status WeightStore::store(std::span<const float> values, const float*& out) {
  Result<std::span<float>> piece = constants_.add(values.size());
  if (!piece) return piece.status();
  std::copy(values.begin(), values.end(), piece->begin());
  out = piece->data();
  return Status::ok();
}

Status WeightStore::pack(int depth, int columns, const std::function<float(int, int)>& weight,
                         std::span<const float> bias, Precision precision,
                         kernels::PackedMatrix& out, int runs) {
  Result<std::span<float>> piece =
      constants_.add(kernels::packed_floats(depth, columns, precision, runs));
  if (!piece) return piece.status();
  out = kernels::pack_matrix(depth, columns, weight, bias, *piece, precision, runs);
  return Status::ok();
}

Status WeightStore::store(const Parameter& parameter, const float*& out) {
  return store(load(parameter), out);
}

Status WeightStore::store_taps(const Parameter& parameter, Precision filter, const float*& out) {
  return store(kernels::pack_filter_taps(load_taps(parameter), filter), out);
}

Status WeightStore::pack_matrix(const Layer& layer, int depth, kernels::PackedMatrix& out,
                                Precision narrowest) {
  const std::vector<float> weight = load(layer.parameters[0]);
  const auto at = [&](int k, int n) {
    return weight[static_cast<std::size_t>(n) * static_cast<std::size_t>(depth) +
                  static_cast<std::size_t>(k)];
  };
  const Precision precision = precision_for(depth, narrowest);
  return pack(depth, layer.output.channels, at, bias_of(layer), precision, out);
}

Status WeightStore::pack3x3(const Layer& layer, Precision precision, kernels::Conv3x3& out) {
  const int channels = input_channels(layer);
  const int used = out.channels;
  const int columns = layer.output.channels;
  const Filters filters{load(layer.parameters[0]), channels, channels - used};
  out.row_winograd = kernels::row_winograd_pays(out.stride, used, columns, precision);
  if (!out.row_winograd) {
    const auto at = [&](int k, int n) { return filters.at(k % used, n, k / used); };
    return pack(9 * used, columns, at, bias_of(layer), precision, out.weights, 3);
  }
  Result<std::span<float>> piece = constants_.add(
      kernels::packed_floats(kernels::row_winograd_depth(used), columns, precision, 3));
  if (!piece) return piece.status();
  out.weights = kernels::pack_row_winograd(
      used, columns, [&filters](int c, int n, int tap) { return filters.at(c, n, tap); },
      bias_of(layer), *piece, precision);
  return Status::ok();
}

Status WeightStore::pack_upsampled(const Layer& layer, int count, kernels::PackedMatrix& out) {
  const int columns = layer.output.channels;
  const Filters filters{load(layer.parameters[0]), input_channels(layer), 0};
  const auto at = [&](int k, int n) { return filters.at(k, n % columns, n / columns); };
  Precision precision = precision_for(count);
  if (precision == Precision::kBfloat16 && columns <= kFewColumns) precision = Precision::kFloat32;
  return pack(count, 9 * columns, at, {}, precision, out);
}

Status WeightStore::pack_winograd(const Layer& layer, kernels::WinogradConv& out) {
  const int columns = layer.output.channels;
  const int used = out.conv.channels;
  const int channels = input_channels(layer);
  const Filters filters{load(layer.parameters[0]), channels, channels - used};
  Result<std::span<float>> panels = constants_.add(kernels::winograd_floats(used, columns));
  if (!panels) return panels.status();
  kernels::pack_winograd(
      used, columns, [&filters](int c, int n, int tap) { return filters.at(c, n, tap); }, *panels);
  out.panels = panels->data();
  out.conv.weights.columns = columns;
  std::vector<float> bias = bias_of(layer);
  bias.resize(static_cast<std::size_t>(columns));  // zeros where there is none
  return store(bias, out.conv.weights.bias);
}

Status WeightStore::pack_head_step(const Layer& layer, Precision precision,
                                   kernels::HeadStep& out) {
  const HeadParameters given{load(layer.parameters[0]), load(layer.parameters[1]),
                             load(layer.parameters[2]), load(layer.parameters[3]),
                             load(layer.parameters[4])};
  const ComposedHead made = compose(given);
  LCDM_RETURN_IF_ERROR(
      store(kernels::pack_composed(made.composed, out.channels, precision), out.composed));
  LCDM_RETURN_IF_ERROR(store(made.constant, out.constant));
  return store(given.scale, out.scale);
}

Status WeightStore::pack_update(const Layer& layer, kernels::HeadUpdate& out) {
  const std::vector<float> taps = load_taps(layer.parameters[0]);
  out.bias = load(layer.parameters[1]).front();
  return store(kernels::pack_update_weights(taps, out.step.channels, out.precision), out.weights);
}

}  // namespace lcdm
