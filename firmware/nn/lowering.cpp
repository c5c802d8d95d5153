// From a typed layer to kernel calls: the CPU's half of Program.
#include <algorithm>
#include <type_traits>
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
#include "firmware/nn/weight_store.h"

namespace lcdm {
namespace {

// A kernel that computes `items` rows (or other units) of its output independently, with scratch or
// without: each worker gets one run of them, cut at multiples of `grain`.
template <typename Args, typename Kernel>
class SlicedStep final : public Step {
 public:
  SlicedStep(const Args& args, Kernel kernel, int items, int grain, std::size_t scratch_floats)
      : args_(args), kernel_(kernel), items_(items), grain_(grain), scratch_(scratch_floats) {}

  void run(int worker, int workers, [[maybe_unused]] float* scratch) const noexcept override {
    const Slice slice = slice_of(items_, worker, workers, grain_);
    if (slice.begin >= slice.end) return;
    if constexpr (std::is_invocable_v<const Kernel&, const Args&, int, int>) {
      kernel_(args_, slice.begin, slice.end);
    } else {
      kernel_(args_, slice.begin, slice.end, scratch);
    }
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
           const std::vector<std::span<float>>& tensors, const LoweringOptions& options,
           ConstantStore& constants, std::vector<std::unique_ptr<Step>>& steps)
      : network_(network),
        index_(index),
        layer_(network.layer(index)),
        output_(tensors[static_cast<std::size_t>(index)].data()),
        tensors_(tensors),
        depth_scale_(options.depth_scale),
        weights_(model, constants, options.precision),
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

  // ---- the layers ----

  // Of the 1x1 convolutions whose output, or whose block's, is layer_'s. The first block, at half
  // the picture's size, shifts the depth of whole frames most. At 1/32 bytes save little, and at
  // some pictures shift the whole frame by a tenth.
  Precision narrowest_of_1x1() const {
    if (2 * layer_.output.width == network_.width()) return Precision::kFloat32;
    if (32 * layer_.output.width == network_.width()) return Precision::kBfloat16;
    return Precision::kInt8;
  }

  // Whether what expands the inverted residual that ends in layer_ has the halves of its filter,
  // which need no range. The first block's shift nothing; those that end at 1/4 cost 2 to 3 % of a
  // frame more than bytes, and leave two thirds of int8's difference in depth, and no frame that
  // changes its size by a fifth.
  bool expands_in_halves(Precision filter) const {
    const int shrunk = network_.width() / layer_.output.width;
    return filter != Precision::kFloat32 && shrunk <= 4;
  }

  struct MatrixArgs {
    kernels::RowInput input;
    kernels::PackedMatrix weights;
    kernels::RowOutput output;
  };

  Status matrix() {
    const int depth = input_shape().channels;
    const int columns = layer_.output.channels;
    MatrixArgs args;
    const Precision narrowest =
        layer_.kind == LayerKind::kConv ? narrowest_of_1x1() : Precision::kInt8;
    LCDM_RETURN_IF_ERROR(weights_.pack_matrix(layer_, depth, args.weights, narrowest));
    args.input = {{input()}, 1, depth, depth, layer_.output.height * layer_.output.width};
    args.output = {output_, layer_.residual >= 0 ? data(layer_.residual) : nullptr, columns,
                   layer_.activation};
    const auto kernel = [](const MatrixArgs& a, int begin, int end) {
      MatrixArgs part = a;
      part.input.run[0] += begin * a.input.stride;
      part.input.rows = end - begin;
      part.output.data += begin * a.output.stride;
      if (part.output.residual != nullptr) part.output.residual += begin * a.output.stride;
      kernels::multiply_rows(part.input, part.weights, part.output);
    };
    return add_step(args, kernel, args.input.rows, kernels::kRowsOfRange);
  }

  void add_input(const Source& source, kernels::Conv3x3& args) const {
    const Shape& in = network_.layer(source.layer).output;
    LCDM_CHECK(static_cast<std::size_t>(args.input_count) < args.inputs.size());
    args.inputs[static_cast<std::size_t>(args.input_count++)] = {
        data(source.layer), in.height, in.width, in.channels, source.upsampling};
    args.channels += in.channels;
  }

  // A norm after the hidden layer needs that in floats.
  Precision head_precision(const Layer& hidden) const {
    if (hidden.stored) return Precision::kFloat32;
    return weights_.head_precision(hidden.output.channels);
  }

  // Whether layer `index` is conv1(condition) of a head in halves, which all its steps read so.
  bool is_read_in_pairs(int index) const {
    return std::any_of(network_.layers().begin(), network_.layers().end(), [&](const Layer& layer) {
      return layer.kind == LayerKind::kHeadHidden && layer.inputs[0].layer == index &&
             head_precision(layer) != Precision::kFloat32;
    });
  }

  // What RowOutput asks of rows in pairs; conv1 of a head in halves has it all.
  static bool comes_in_pairs(const Layer& layer, const kernels::Conv3x3& conv,
                             Precision precision) {
    return precision == Precision::kBfloat16 && conv.upsampled.data == nullptr &&
           layer.activation == Activation::kNone &&
           layer.output.channels <= kernels::vector_lanes();
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
    args.paired = is_read_in_pairs(index);
    for (const Source& source : layer.inputs) {
      if (source.upsampling == Upsampling::kBilinear) {  // the first, if any
        const Shape& in = network_.layer(source.layer).output;
        args.upsampled = {data(source.layer), in.height, in.width, in.channels, {}};
        LCDM_RETURN_IF_ERROR(weights_.pack_upsampled(layer, in.channels, args.upsampled.taps));
      } else {
        add_input(source, args);
      }
    }
    return Status::ok();
  }

  Status winograd(kernels::WinogradConv& args) {
    LCDM_RETURN_IF_ERROR(weights_.pack_winograd(layer_, args));
    return add_step(args, &kernels::winograd_rows, layer_.output.height, kernels::kWinogradTile,
                    kernels::winograd_scratch(args));
  }

  // Bytes where they cost little accuracy: beside an upsampled share and to many channels. Towards
  // the picture's own size they gain little more and leave grain. The fewest channels cost some
  // even in halves.
  Precision precision_of_3x3(const Layer& layer, const kernels::Conv3x3& conv) const {
    if (layer.output.channels < 16) return Precision::kFloat32;
    const bool bytes = conv.upsampled.data != nullptr || layer.output.channels >= 48;
    const Precision narrowest = bytes ? Precision::kInt8 : Precision::kBfloat16;
    return weights_.precision_for(9 * conv.channels, narrowest, 3);
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
      const Precision precision = precision_of_3x3(network_.layer(index), conv);
      LCDM_CHECK(!conv.paired || comes_in_pairs(network_.layer(index), conv, precision));
      if (index == index_ && kernels::winograd_pays(conv, layer_.output.channels, precision)) {
        kernels::WinogradConv args{chain, conv, nullptr};
        return winograd(args);
      }
      LCDM_RETURN_IF_ERROR(weights_.pack3x3(network_.layer(index), precision, conv));
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
    args.filter = weights_.filter_precision();
    const Precision narrowest = narrowest_of_1x1();
    LCDM_RETURN_IF_ERROR(
        weights_.pack_matrix(expand, in.channels, args.expand,
                             expands_in_halves(args.filter) ? args.filter : narrowest));
    if (args.expand.precision == Precision::kFloat32) args.filter = Precision::kFloat32;
    LCDM_RETURN_IF_ERROR(weights_.store_taps(filter.parameters[0], args.filter, args.taps));
    LCDM_RETURN_IF_ERROR(weights_.store(filter.parameters[1], args.taps_bias));
    LCDM_RETURN_IF_ERROR(weights_.pack_matrix(layer_, args.hidden, args.project, narrowest));
    return add_step(args, &kernels::inverted_residual_rows, layer_.output.height, 1,
                    kernels::inverted_residual_scratch(args));
  }

  Status resize() {
    const Shape& in = input_shape();
    const Shape& out = layer_.output;
    const kernels::Resize args = {input(),   in.height,    in.width, out.height,
                                  out.width, out.channels, output_};
    return add_step(args, &kernels::resize_rows, out.height);
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
    const auto kernel = [](const PatchArgs& a, int begin, int end) {
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
    LCDM_RETURN_IF_ERROR(weights_.store(layer_.parameters[0], args.weight));
    LCDM_RETURN_IF_ERROR(weights_.store(layer_.parameters[1], args.bias));
    return add_step(args, &kernels::layer_norm_rows, layer_.output.height * layer_.output.width);
  }

  Status attention() {
    const Shape& out = layer_.output;
    const Precision precision =
        weights_.precision_for(out.channels / Network::kHeads, Precision::kBfloat16);
    const kernels::Attention args = {input(),         out.height, out.width, out.channels,
                                     Network::kHeads, output_,    precision};
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
    LCDM_RETURN_IF_ERROR(weights_.store(layer_.parameters[0], args.weight));
    LCDM_RETURN_IF_ERROR(weights_.store(layer_.parameters[1], args.bias));
    args.row_moments = output_ + out.count();  // the plan leaves room for them
    LCDM_RETURN_IF_ERROR(add_step(args, &kernels::group_norm_moments, out.height));
    return add_step(args, &kernels::group_norm_apply, out.height);
  }

  Status make_head_step(const Layer& layer, Precision precision, kernels::HeadStep& out) {
    const int state = layer.inputs[1].layer;
    const bool starts_at_zero = network_.layer(state).kind == LayerKind::kStart &&
                                network_.config().start == StartKind::kZeros;
    out.shared = data(layer.inputs[0].layer);
    out.state = starts_at_zero ? nullptr : data(state);
    out.height = layer.output.height;
    out.width = layer.output.width;
    out.channels = layer.output.channels;
    out.relu = layer.activation == Activation::kRelu;
    return weights_.pack_head_step(layer, precision, out);
  }

  // Only where a norm needs it whole.
  Status head_hidden() {
    kernels::HeadStep args;
    LCDM_RETURN_IF_ERROR(make_head_step(layer_, Precision::kFloat32, args));
    args.hidden = output_;
    return add_step(args, &kernels::head_hidden_rows, args.height);
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
      args.precision = head_precision(hidden);
      LCDM_RETURN_IF_ERROR(make_head_step(hidden, args.precision, args.step));
      args.step.hidden = tensors_[static_cast<std::size_t>(source(0).layer)].data();
    }
    LCDM_RETURN_IF_ERROR(weights_.pack_update(layer_, args));
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
    return add_step(args, &kernels::depth_range, layer_.output.height * layer_.output.width, 64);
  }

  const Network& network_;
  int index_;
  const Layer& layer_;
  float* output_;
  const std::vector<std::span<float>>& tensors_;
  float depth_scale_;
  WeightStore weights_;
  std::vector<std::unique_ptr<Step>>& steps_;
};

}  // namespace

Status lower_layer(const Network& network, int index, const ModelFile& model,
                   const std::vector<std::span<float>>& tensors, const LoweringOptions& options,
                   ConstantStore& constants, std::vector<std::unique_ptr<Step>>& steps) {
  return Lowering(network, index, model, tensors, options, constants, steps).lower();
}

}  // namespace lcdm
