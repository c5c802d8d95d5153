// From a typed layer to kernel calls: the CPU's half of Program.
#include <algorithm>
#include <utility>

#include "firmware/nn/kernels/attention.h"
#include "firmware/nn/kernels/conv.h"
#include "firmware/nn/kernels/head.h"
#include "firmware/nn/kernels/matrix.h"
#include "firmware/nn/kernels/norm.h"
#include "firmware/nn/kernels/reshape.h"
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
        layer_(network.layer(index)),
        output_(tensors[static_cast<std::size_t>(index)].data()),
        model_(model),
        tensors_(tensors),
        depth_scale_(depth_scale),
        constants_(constants),
        steps_(steps) {}

  Status lower() {
    switch (layer_.kind) {
      case LayerKind::kInput:
      case LayerKind::kStart:
        return Status::ok();
      case LayerKind::kConv:
        return layer_.kernel == 1 ? matrix() : conv3x3();
      case LayerKind::kLinear:
        return matrix();
      case LayerKind::kDepthwise:
        return depthwise();
      case LayerKind::kResize:
        return resize();
      case LayerKind::kUnfold:
      case LayerKind::kFold:
        return patches();
      case LayerKind::kLayerNorm:
        return layer_norm();
      case LayerKind::kAttention:
        return attention();
      case LayerKind::kFusedConv:
        return fused_conv();
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

  std::vector<float> load(std::size_t parameter) const {
    const auto found = model_.tensors().find(layer_.parameters[parameter].name);
    LCDM_CHECK(found != model_.tensors().end());  // check_weights has seen it
    std::vector<float> values(found->second.count);
    model_.read(found->second, values);
    return values;
  }

  Status store(std::span<const float> values, const float*& out) {
    Result<std::span<float>> piece = constants_.add(values.size());
    if (!piece) return piece.status();
    std::copy(values.begin(), values.end(), piece->begin());
    out = piece->data();
    return Status::ok();
  }

  // A parameter as it is in the file.
  Status store(std::size_t parameter, const float*& out) { return store(load(parameter), out); }

  // [channels, 1, 3, 3] or [1, channels, 3, 3] in the file becomes [9, channels].
  Status store_taps(std::size_t parameter, const float*& out) {
    const std::vector<float> values = load(parameter);
    const std::size_t channels = values.size() / 9;
    std::vector<float> taps(values.size());
    for (std::size_t c = 0; c < channels; ++c) {
      for (std::size_t t = 0; t < 9; ++t) taps[t * channels + c] = values[c * 9 + t];
    }
    return store(taps, out);
  }

  Status pack(int depth, int columns, const std::function<float(int, int)>& weight,
              std::span<const float> bias, kernels::PackedMatrix& out) {
    Result<std::span<float>> piece = constants_.add(kernels::packed_floats(depth, columns));
    if (!piece) return piece.status();
    out = kernels::pack_matrix(depth, columns, weight, bias, *piece);
    return Status::ok();
  }

  // A 3x3 weight [columns, channels, 3, 3] with its bias, k = tap * channels + c.
  Status pack3x3(std::size_t weight_parameter, std::size_t bias_parameter, int channels,
                 kernels::PackedMatrix& out) {
    const std::vector<float> weight = load(weight_parameter);
    const auto at = [&](int k, int n) {
      const int filter = n * channels + k % channels;
      return weight[static_cast<std::size_t>(filter) * 9 + static_cast<std::size_t>(k / channels)];
    };
    return pack(9 * channels, layer_.output.channels, at, load(bias_parameter), out);
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
    const std::vector<float> weight = load(0);
    const std::vector<float> bias = layer_.parameters.size() > 1 ? load(1) : std::vector<float>{};
    MatrixArgs args;
    LCDM_RETURN_IF_ERROR(pack(
        depth, columns,
        [&](int k, int n) { return weight[static_cast<std::size_t>(n * depth + k)]; }, bias,
        args.weights));
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

  kernels::Conv3x3 conv_args() const {
    kernels::Conv3x3 args;
    args.input_count = 0;
    args.stride = layer_.stride;
    args.height = layer_.output.height * layer_.stride;
    args.width = layer_.output.width * layer_.stride;
    args.padding = layer_.padding;
    args.activation = layer_.activation;
    args.output = output_;
    return args;
  }

  void add_input(kernels::Conv3x3& args, std::size_t i) const {
    const Shape& in = input_shape(i);
    LCDM_CHECK(static_cast<std::size_t>(args.input_count) < args.inputs.size());
    args.inputs[static_cast<std::size_t>(args.input_count++)] = {input(i), in.height, in.width,
                                                                 in.channels, source(i).upsampling};
    args.channels += in.channels;
  }

  Status add_conv(const kernels::Conv3x3& args) {
    return add_step(args, &kernels::conv3x3_rows, layer_.output.height, 1,
                    kernels::conv3x3_scratch(args));
  }

  Status conv3x3() {
    kernels::Conv3x3 args = conv_args();
    for (std::size_t i = 0; i < layer_.inputs.size(); ++i) add_input(args, i);
    LCDM_RETURN_IF_ERROR(pack3x3(0, 1, args.channels, args.weights));
    return add_conv(args);
  }

  Status fused_conv() {
    kernels::Conv3x3 args = conv_args();
    add_input(args, 0);
    args.embedding.state = input(1);
    LCDM_RETURN_IF_ERROR(store_taps(0, args.embedding.weights));
    LCDM_RETURN_IF_ERROR(store(1, args.embedding.bias));
    LCDM_RETURN_IF_ERROR(pack3x3(2, 3, args.channels, args.weights));
    return add_conv(args);
  }

  Status depthwise() {
    const Shape& in = input_shape();
    kernels::Depthwise3x3 args;
    args.input = input();
    args.height = in.height;
    args.width = in.width;
    args.channels = in.channels;
    args.stride = layer_.stride;
    args.output = output_;
    LCDM_RETURN_IF_ERROR(store_taps(0, args.weights));
    LCDM_RETURN_IF_ERROR(store(1, args.bias));
    const auto kernel = [](const kernels::Depthwise3x3& a, int begin, int end, float*) {
      kernels::depthwise3x3_rows(a, begin, end);
    };
    return add_step(args, kernel, layer_.output.height);
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

  Status update() {
    const Shape& h = input_shape();
    const SamplerStep step = make_sampler(network_.config())[static_cast<std::size_t>(layer_.step)];
    kernels::Update args;
    args.h = input(0);
    args.height = h.height;
    args.width = h.width;
    args.channels = h.channels;
    args.bias = load(1).front();
    args.p = static_cast<float>(step.p);
    args.q = static_cast<float>(step.q);
    args.state = input(1);
    args.next = output_;
    LCDM_RETURN_IF_ERROR(store_taps(0, args.weights));
    const auto kernel = [](const kernels::Update& a, int begin, int end, float*) {
      kernels::update_rows(a, begin, end);
    };
    return add_step(args, kernel, h.height);
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
