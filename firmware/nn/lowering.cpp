// From a typed layer to kernel calls: the CPU's half of Program.
#include <algorithm>
#include <utility>

#include "firmware/nn/kernels/attention.h"
#include "firmware/nn/kernels/conv.h"
#include "firmware/nn/kernels/head.h"
#include "firmware/nn/kernels/inverted_residual.h"
#include "firmware/nn/kernels/matrix.h"
#include "firmware/nn/kernels/norm.h"
#include "firmware/nn/kernels/reshape.h"
#include "firmware/nn/kernels/winograd.h"
#include "firmware/nn/program.h"
#include "firmware/nn/sampler.h"

namespace lcdm {
namespace {

// A kernel that computes `items` rows (or other units) of its output independently: each worker
// gets one run of them, cut at multiples of `grain`.
template <typename Args, typename Kernel>
class SlicedStep final : public Step {
 public:
  SlicedStep(const Args& args, Kernel kernel, int items, int grain, std::size_t scratch_floats)
      : args_(args), kernel_(kernel), items_(items), grain_(grain), scratch_(scratch_floats) {}

  void run(int worker, int workers, float* scratch) const noexcept override {
    const Slice slice = slice_of(items_, worker, workers, grain_);
    if (slice.begin < slice.end) kernel_(args_, slice.begin, slice.end, scratch);
  }
  std::size_t scratch_floats() const override { return scratch_; }

 private:
  Args args_;
  Kernel kernel_;
  int items_;
  int grain_;
  std::size_t scratch_;
};

class Lowering {
 public:
  Lowering(const Network& network, int index, const ModelFile& model,
           const std::vector<std::span<float>>& tensors, float depth_scale,
           ConstantStore& constants, std::vector<std::unique_ptr<Step>>& steps)
      : network_(network),
        index_(index),
        layer_(network.layer(index)),
        output_(tensors[static_cast<std::size_t>(index)].data()),
        model_(model),
        tensors_(tensors),
        depth_scale_(depth_scale),
        constants_(constants),
        steps_(steps) {}

  Status lower() {
    if (!layer_.stored) return Status::ok();  // its reader computes it
    switch (layer_.kind) {
      case LayerKind::kInput:
      case LayerKind::kStart:
        return Status::ok();
      case LayerKind::kConv:
        if (layer_.kernel == 3) return conv3x3();
        return network_.layer(source(0).layer).stored ? matrix() : inverted_residual();
      case LayerKind::kLinear:
        return matrix();
      case LayerKind::kDepthwise:
        LCDM_CHECK(false);  // only inside an inverted residual
      case LayerKind::kResize:
        return resize();
      case LayerKind::kUnfold:
      case LayerKind::kFold:
        return patches();
      case LayerKind::kLayerNorm:
        return layer_norm();
      case LayerKind::kAttention:
        return attention();
      case LayerKind::kHeadHidden:
        return head_hidden();
      case LayerKind::kGroupNorm:
        return group_norm();
      case LayerKind::kUpdate:
        return update();
      case LayerKind::kDepth:
        return depth();
    }
    return Status::ok();
  }

 private:
  // ---- what every layer needs ----

  const Source& source(std::size_t i) const { return layer_.inputs[i]; }
  const float* input(std::size_t i = 0) const { return data(source(i).layer); }
  const Shape& input_shape(std::size_t i = 0) const {
    return network_.layer(source(i).layer).output;
  }
  const float* data(int layer) const { return tensors_[static_cast<std::size_t>(layer)].data(); }

  template <typename Args, typename Kernel>
  Status add_step(const Args& args, Kernel kernel, int items, int grain = 1,
                  std::size_t scratch_floats = 0) {
    steps_.push_back(
        std::make_unique<SlicedStep<Args, Kernel>>(args, kernel, items, grain, scratch_floats));
    return Status::ok();
  }

  std::vector<float> load(const Parameter& parameter) const {
    const auto found = model_.tensors().find(parameter.name);
    LCDM_CHECK(found != model_.tensors().end());  // check_weights has seen it
    std::vector<float> values(found->second.count);
    model_.read(found->second, values);
    return values;
  }
  std::vector<float> load(std::size_t parameter) const {
    return load(layer_.parameters[parameter]);
  }

  Status store(std::span<const float> values, const float*& out) {
    Result<std::span<float>> piece = constants_.add(values.size());
    if (!piece) return piece.status();
    std::copy(values.begin(), values.end(), piece->begin());
    out = piece->data();
    return Status::ok();
  }

  // A parameter as it is in the file.
  Status store(const Parameter& parameter, const float*& out) {
    return store(load(parameter), out);
  }
  Status store(std::size_t parameter, const float*& out) {
    return store(layer_.parameters[parameter], out);
  }

  // [channels, 1, 3, 3] or [1, channels, 3, 3] in the file becomes [9, channels].
  std::vector<float> load_taps(const Parameter& parameter) const {
    const std::vector<float> values = load(parameter);
    const std::size_t channels = values.size() / 9;
    std::vector<float> taps(values.size());
    for (std::size_t c = 0; c < channels; ++c) {
      for (std::size_t t = 0; t < 9; ++t) taps[t * channels + c] = values[c * 9 + t];
    }
    return taps;
  }
  Status store_taps(const Parameter& parameter, const float*& out) {
    return store(load_taps(parameter), out);
  }

  Status pack(int depth, int columns, const std::function<float(int, int)>& weight,
              std::span<const float> bias, kernels::PackedMatrix& out) {
    Result<std::span<float>> piece = constants_.add(kernels::packed_floats(depth, columns));
    if (!piece) return piece.status();
    out = kernels::pack_matrix(depth, columns, weight, bias, *piece);
    return Status::ok();
  }

  // The last `used` channels of a 3x3 weight [columns, channels, 3, 3]: those before are upsampled.
  struct Filters {
    std::vector<float> values;
    int channels = 0;
    int used = 0;

    float at(int c, int n, int tap) const {
      const int filter = n * channels + channels - used + c;
      return values[static_cast<std::size_t>(filter) * 9 + static_cast<std::size_t>(tap)];
    }
  };
  Filters filters_of(const Layer& layer, int used) const {
    return {load(layer.parameters[0]), static_cast<int>(layer.parameters[0].shape[1]), used};
  }

  // With the bias; k = tap * channels + c.
  Status pack3x3(const Layer& layer, kernels::Conv3x3& args) {
    const Filters filters = filters_of(layer, args.channels);
    const auto at = [&](int k, int n) { return filters.at(k % filters.used, n, k / filters.used); };
    return pack(9 * filters.used, layer.output.channels, at, bias_of(layer), args.weights);
  }

  // Of a convolution or linear layer; empty where it has none.
  std::vector<float> bias_of(const Layer& layer) const {
    return layer.parameters.size() > 1 ? load(layer.parameters[1]) : std::vector<float>{};
  }

  // The weight [columns, depth] and, where there is one, the bias of a 1x1 convolution or a linear
  // layer.
  Status pack_matrix(const Layer& layer, int depth, kernels::PackedMatrix& out) {
    const std::vector<float> weight = load(layer.parameters[0]);
    const auto at = [&](int k, int n) { return weight[static_cast<std::size_t>(n * depth + k)]; };
    return pack(depth, layer.output.channels, at, bias_of(layer), out);
  }

  // ---- the layers ----

  struct MatrixArgs {
    kernels::RowInput input;
    kernels::PackedMatrix weights;
    kernels::RowOutput output;
  };

  Status matrix() {
    const int depth = input_shape().channels;
    const int columns = layer_.output.channels;
    MatrixArgs args;
    LCDM_RETURN_IF_ERROR(pack_matrix(layer_, depth, args.weights));
    args.input = {{input()}, 1, depth, depth, layer_.output.height * layer_.output.width};
    args.output = {output_, layer_.residual >= 0 ? data(layer_.residual) : nullptr, columns,
                   layer_.activation};
    const auto kernel = [](const MatrixArgs& a, int begin, int end, float*) {
      MatrixArgs part = a;
      part.input.run[0] += begin * a.input.stride;
      part.input.rows = end - begin;
      part.output.data += begin * a.output.stride;
      if (part.output.residual != nullptr) part.output.residual += begin * a.output.stride;
      kernels::multiply_rows(part.input, part.weights, part.output);
    };
    return add_step(args, kernel, args.input.rows, 8);
  }

  // Its part of a 3x3 weight, one 1x1 convolution for each tap.
  Status add_upsampled(const Layer& layer, kernels::Conv3x3& args) {
    const std::vector<float> weight = load(layer.parameters[0]);
    const Shape& in = network_.layer(layer.inputs[0].layer).output;
    const int columns = layer.output.channels;
    const auto channels = static_cast<int>(layer.parameters[0].shape[1]);
    args.upsampled = {data(layer.inputs[0].layer), in.height, in.width, in.channels, {}};
    const auto at = [&](int k, int n) {
      const int filter = n % columns * channels + k;
      return weight[static_cast<std::size_t>(filter) * 9 + static_cast<std::size_t>(n / columns)];
    };
    return pack(in.channels, 9 * columns, at, {}, args.upsampled.taps);
  }

  void add_input(const Source& source, kernels::Conv3x3& args) const {
    const Shape& in = network_.layer(source.layer).output;
    LCDM_CHECK(static_cast<std::size_t>(args.input_count) < args.inputs.size());
    args.inputs[static_cast<std::size_t>(args.input_count++)] = {
        data(source.layer), in.height, in.width, in.channels, source.upsampling};
    args.channels += in.channels;
  }

  // All but the weights of the inputs that are not upsampled.
  Status make_conv(int index, kernels::Conv3x3& args) {
    const Layer& layer = network_.layer(index);
    args.input_count = 0;
    args.stride = layer.stride;
    args.height = layer.output.height * layer.stride;
    args.width = layer.output.width * layer.stride;
    args.padding = layer.padding;
    args.activation = layer.activation;
    args.output = tensors_[static_cast<std::size_t>(index)].data();
    for (const Source& source : layer.inputs) {
      if (source.upsampling == Upsampling::kBilinear) {  // the first, if any
        LCDM_RETURN_IF_ERROR(add_upsampled(layer, args));
      } else {
        add_input(source, args);
      }
    }
    return Status::ok();
  }

  Status winograd(kernels::WinogradConv& args) {
    const int columns = layer_.output.channels;
    const Filters filters = filters_of(layer_, args.conv.channels);
    Result<std::span<float>> panels =
        constants_.add(kernels::winograd_floats(filters.used, columns));
    if (!panels) return panels.status();
    kernels::pack_winograd(
        filters.used, columns, [&filters](int c, int n, int tap) { return filters.at(c, n, tap); },
        *panels);
    args.panels = panels->data();
    args.conv.weights.columns = columns;
    std::vector<float> bias = bias_of(layer_);
    bias.resize(static_cast<std::size_t>(columns));  // zeros where there is none
    LCDM_RETURN_IF_ERROR(store(bias, args.conv.weights.bias));
    return add_step(args, &kernels::winograd_rows, layer_.output.height, kernels::kWinogradTile,
                    kernels::winograd_scratch(args));
  }

  // With the convolutions before it whose outputs are not stored.
  Status conv3x3() {
    std::vector<int> indices = {index_};
    for (int before = source(0).layer; !network_.layer(before).stored;) {
      indices.insert(indices.begin(), before);
      before = network_.layer(before).inputs[0].layer;
    }
    kernels::ConvChain chain;
    LCDM_CHECK(indices.size() <= chain.convs.size());
    for (const int index : indices) {
      kernels::Conv3x3& conv = chain.convs[static_cast<std::size_t>(chain.count)];
      LCDM_RETURN_IF_ERROR(make_conv(index, conv));
      if (index == index_ && kernels::winograd_pays(conv, layer_.output.channels)) {
        kernels::WinogradConv args{chain, conv, nullptr};
        return winograd(args);
      }
      LCDM_RETURN_IF_ERROR(pack3x3(network_.layer(index), conv));
      ++chain.count;
    }
    return add_step(chain, &kernels::conv3x3_rows, layer_.output.height, 1,
                    kernels::conv3x3_scratch(chain));
  }

  // Expand, depthwise, project: layer_ is the last of the three.
  Status inverted_residual() {
    const Layer& filter = network_.layer(source(0).layer);
    const Layer& expand = network_.layer(filter.inputs[0].layer);
    const int first = expand.inputs[0].layer;
    const Shape& in = network_.layer(first).output;
    kernels::InvertedResidual args;
    args.input = data(first);
    args.height = in.height;
    args.width = in.width;
    args.channels = in.channels;
    args.hidden = expand.output.channels;
    args.stride = filter.stride;
    args.residual = layer_.residual >= 0 ? data(layer_.residual) : nullptr;
    args.output = output_;
    args.expanded = tensors_[static_cast<std::size_t>(filter.inputs[0].layer)].data();
    args.filtered = tensors_[static_cast<std::size_t>(source(0).layer)].data();
    LCDM_RETURN_IF_ERROR(pack_matrix(expand, in.channels, args.expand));
    LCDM_RETURN_IF_ERROR(store_taps(filter.parameters[0], args.taps));
    LCDM_RETURN_IF_ERROR(store(filter.parameters[1], args.taps_bias));
    LCDM_RETURN_IF_ERROR(pack_matrix(layer_, args.hidden, args.project));
    return add_step(args, &kernels::inverted_residual_rows, layer_.output.height, 1,
                    kernels::inverted_residual_scratch(args));
  }

  Status resize() {
    const Shape& in = input_shape();
    const Shape& out = layer_.output;
    const kernels::Resize args = {input(),   in.height,    in.width, out.height,
                                  out.width, out.channels, output_};
    const auto kernel = [](const kernels::Resize& a, int begin, int end, float*) {
      kernels::resize_rows(a, begin, end);
    };
    return add_step(args, kernel, out.height);
  }

  struct PatchArgs {
    kernels::Patches patches;
    const float* from;
    float* to;
    bool unfold;
  };

  Status patches() {
    const bool unfold = layer_.kind == LayerKind::kUnfold;
    const Shape& image = unfold ? input_shape() : layer_.output;
    const PatchArgs args = {{image.height, image.width, image.channels}, input(), output_, unfold};
    const auto kernel = [](const PatchArgs& a, int begin, int end, float*) {
      const auto move = a.unfold ? &kernels::unfold_rows : &kernels::fold_rows;
      move(a.patches, a.from, a.to, begin, end);
    };
    return add_step(args, kernel, image.height / 2);
  }

  Status layer_norm() {
    kernels::LayerNorm args;
    args.input = input();
    args.channels = layer_.output.channels;
    args.epsilon = Network::kNormEpsilon;
    args.output = output_;
    LCDM_RETURN_IF_ERROR(store(0, args.weight));
    LCDM_RETURN_IF_ERROR(store(1, args.bias));
    const auto kernel = [](const kernels::LayerNorm& a, int begin, int end, float*) {
      kernels::layer_norm_rows(a, begin, end);
    };
    return add_step(args, kernel, layer_.output.height * layer_.output.width);
  }

  Status attention() {
    const Shape& out = layer_.output;
    const kernels::Attention args = {input(),      out.height,      out.width,
                                     out.channels, Network::kHeads, output_};
    return add_step(args, &kernels::attention_range, kernels::attention_items(args), 1,
                    kernels::attention_scratch(args));
  }

  Status group_norm() {
    const Shape& out = layer_.output;
    kernels::GroupNorm args;
    args.input = input();
    args.height = out.height;
    args.width = out.width;
    args.channels = out.channels;
    args.groups = Network::kGroups;
    args.epsilon = Network::kNormEpsilon;
    args.activation = layer_.activation;
    args.output = output_;
    LCDM_RETURN_IF_ERROR(store(0, args.weight));
    LCDM_RETURN_IF_ERROR(store(1, args.bias));
    const auto rows = static_cast<std::size_t>(out.height);
    Result<std::span<float>> sums =
        constants_.add(rows * 2 * static_cast<std::size_t>(out.channels));
    if (!sums) return sums.status();
    args.row_sums = sums->data();
    const auto sum = [](const kernels::GroupNorm& a, int begin, int end, float*) {
      kernels::group_norm_sums(a, begin, end);
    };
    const auto apply = [](const kernels::GroupNorm& a, int begin, int end, float*) {
      kernels::group_norm_apply(a, begin, end);
    };
    LCDM_RETURN_IF_ERROR(add_step(args, sum, out.height));
    return add_step(args, apply, out.height);
  }

  // Everything of a step's hidden layer; composed in double.
  Status make_head_step(const Layer& layer, kernels::HeadStep& out) {
    const auto channels = static_cast<std::size_t>(layer.output.channels);
    const int state = layer.inputs[1].layer;
    const bool starts_at_zero = network_.layer(state).kind == LayerKind::kStart &&
                                network_.config().start == StartKind::kZeros;
    out.shared = data(layer.inputs[0].layer);
    out.state = starts_at_zero ? nullptr : data(state);
    out.height = layer.output.height;
    out.width = layer.output.width;
    out.channels = layer.output.channels;
    out.relu = layer.activation == Activation::kRelu;

    const std::vector<float> embed = load(layer.parameters[0]);
    const std::vector<float> time = load(layer.parameters[1]);
    const std::vector<float> conv1 = load(layer.parameters[2]);
    const std::vector<float> scale = load(layer.parameters[3]);
    const std::vector<float> bias = load(layer.parameters[4]);
    std::vector<float> composed(25 * channels);
    std::vector<float> constant(channels);
    std::vector<float> taps(9 * channels * channels);
    for (std::size_t n = 0; n < channels; ++n) {
      const auto s = static_cast<double>(scale[n]);
      double sums[25] = {};
      auto steady = static_cast<double>(bias[n]);
      for (std::size_t c = 0; c < channels; ++c) {
        for (std::size_t t = 0; t < 9; ++t) {
          const float weight = conv1[(n * channels + c) * 9 + t];
          taps[(t * channels + c) * channels + n] = weight;
          const double scaled = s * static_cast<double>(weight);
          steady += scaled * static_cast<double>(time[c]);
          for (std::size_t e = 0; e < 9; ++e) {
            const std::size_t at = 5 * (t / 3 + e / 3) + t % 3 + e % 3;
            sums[at] += scaled * static_cast<double>(embed[c * 9 + e]);
          }
        }
      }
      constant[n] = static_cast<float>(steady);
      for (std::size_t i = 0; i < 25; ++i) composed[i * channels + n] = static_cast<float>(sums[i]);
    }
    LCDM_RETURN_IF_ERROR(store(composed, out.composed));
    LCDM_RETURN_IF_ERROR(store(constant, out.constant));
    LCDM_RETURN_IF_ERROR(store(taps, out.conv1));
    LCDM_RETURN_IF_ERROR(store(scale, out.scale));
    LCDM_RETURN_IF_ERROR(store(bias, out.bias));
    LCDM_RETURN_IF_ERROR(store(time, out.time));
    return store_taps(layer.parameters[0], out.embed);
  }

  // Only where a norm needs it whole.
  Status head_hidden() {
    kernels::HeadStep args;
    LCDM_RETURN_IF_ERROR(make_head_step(layer_, args));
    args.hidden = output_;
    const auto kernel = [](const kernels::HeadStep& a, int begin, int end, float*) {
      kernels::head_hidden_rows(a, begin, end);
    };
    return add_step(args, kernel, args.height);
  }

  Status update() {
    const Layer& hidden = network_.layer(source(0).layer);
    const SamplerStep step = make_sampler(network_.config())[static_cast<std::size_t>(layer_.step)];
    kernels::HeadUpdate args;
    if (hidden.stored) {
      args.hidden = input(0);
      args.step.height = hidden.output.height;
      args.step.width = hidden.output.width;
      args.step.channels = hidden.output.channels;
    } else {
      LCDM_RETURN_IF_ERROR(make_head_step(hidden, args.step));
      args.step.hidden = tensors_[static_cast<std::size_t>(source(0).layer)].data();
    }
    Result<std::span<float>> packed =
        constants_.add(kernels::update_weight_floats(args.step.channels));
    if (!packed) return packed.status();
    kernels::pack_update_weights(load_taps(layer_.parameters[0]).data(), args.step.channels,
                                 packed->data());
    args.weights = packed->data();
    args.bias = load(1).front();
    args.p = static_cast<float>(step.p);
    args.q = static_cast<float>(step.q);
    args.state = input(1);
    args.next = output_;
    return add_step(args, &kernels::head_update_rows, args.step.height, 1,
                    kernels::head_update_scratch(args));
  }

  Status depth() {
    const ModelConfig& config = network_.config();
    const kernels::ToDepth args = {input(), static_cast<float>(config.variable_std),
                                   static_cast<float>(config.variable_mean), depth_scale_, output_};
    const auto kernel = [](const kernels::ToDepth& a, int begin, int end, float*) {
      kernels::depth_range(a, begin, end);
    };
    return add_step(args, kernel, layer_.output.height * layer_.output.width, 64);
  }

  const Network& network_;
  int index_;
  const Layer& layer_;
  float* output_;
  const ModelFile& model_;
  const std::vector<std::span<float>>& tensors_;
  float depth_scale_;
  ConstantStore& constants_;
  std::vector<std::unique_ptr<Step>>& steps_;
};

}  // namespace

Status lower_layer(const Network& network, int index, const ModelFile& model,
                   const std::vector<std::span<float>>& tensors, float depth_scale,
                   ConstantStore& constants, std::vector<std::unique_ptr<Step>>& steps) {
  return Lowering(network, index, model, tensors, depth_scale, constants, steps).lower();
}

}  // namespace lcdm
