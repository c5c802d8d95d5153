#include "model/onnx_export.h"

#include <cmath>
#include <set>
#include <vector>

#include "firmware/nn/network.h"
#include "firmware/nn/noise.h"
#include "firmware/nn/sampler.h"
#include "model/depth_code.h"
#include "model/onnx_graph.h"

namespace lcdm::model {
namespace {

using Ints = std::vector<std::int64_t>;

// ONNX is NCHW; a sequence of tokens is [positions, tokens, channels] as in the layer list.
class Exporter {
 public:
  Exporter(const Network& network, const ModelFile& file, OnnxGraph& graph)
      : network_(network), file_(file), graph_(graph) {}

  void run() {
    for (const Layer& layer : network_.layers()) values_.push_back(emit(layer));
    const Shape& plane = network_.layers().back().output;
    graph_.output("depth", {1, 1, plane.height, plane.width});
  }

 private:
  std::string emit(const Layer& layer) {
    if (is_shared_conv1(layer)) return "";  // each step does its own
    switch (layer.kind) {
      case LayerKind::kInput:
        return graph_.input("image", {1, 3, layer.output.height, layer.output.width});
      case LayerKind::kConv:
      case LayerKind::kDepthwise:
        return convolution(layer);
      case LayerKind::kLinear:
        return linear(layer);
      case LayerKind::kResize:
        return resize(layer.name, value(layer, 0), layer.output, Upsampling::kBilinear);
      case LayerKind::kUnfold:
        return unfold(layer);
      case LayerKind::kFold:
        return fold(layer);
      case LayerKind::kLayerNorm:
        return graph_.node(layer.name, "LayerNormalization",
                           {value(layer, 0), weight(layer, 0), weight(layer, 1)},
                           {{"epsilon", Network::kNormEpsilon}});
      case LayerKind::kAttention:
        return attention(layer);
      case LayerKind::kStart:
        return start(layer);
      case LayerKind::kHeadHidden:
        return head_hidden(layer);
      case LayerKind::kGroupNorm:
        return group_norm(layer);
      case LayerKind::kUpdate:
        return update(layer);
      case LayerKind::kDepth:
        return depth(layer);
    }
    LCDM_CHECK(false);
  }

  static bool is_shared_conv1(const Layer& layer) { return layer.name == "head.conv1"; }

  const Layer& source(const Layer& layer, std::size_t input) const {
    return network_.layer(layer.inputs[input].layer);
  }
  const std::string& value(int layer) const { return values_[static_cast<std::size_t>(layer)]; }
  const std::string& value(const Layer& layer, std::size_t input) const {
    return value(layer.inputs[input].layer);
  }

  std::vector<float> read(const Parameter& parameter) const {
    const ModelFile::Tensor& tensor = file_.tensors().at(parameter.name);
    std::vector<float> values(tensor.count);
    file_.read(tensor, values);
    return values;
  }
  // The parameter as a constant, written once.
  std::string weight(const Layer& layer, std::size_t index) {
    const Parameter& parameter = layer.parameters[index];
    if (written_.insert(parameter.name).second) {
      graph_.constant(parameter.name, parameter.shape, read(parameter));
    }
    return parameter.name;
  }

  std::string activate(const std::string& name, const std::string& x, Activation activation) {
    switch (activation) {
      case Activation::kNone:
        return x;
      case Activation::kSilu:
        return graph_.node(name + ".silu", "Mul",
                           {x, graph_.node(name + ".sigmoid", "Sigmoid", {x})});
      case Activation::kElu:
        return graph_.node(name + ".elu", "Elu", {x});
      case Activation::kRelu:
        return graph_.node(name + ".relu", "Relu", {x});
    }
    LCDM_CHECK(false);
  }

  std::string resize(const std::string& name, const std::string& x, const Shape& out,
                     Upsampling how) {
    const bool bilinear = how == Upsampling::kBilinear;
    const std::string sizes =
        graph_.integers(name + ".sizes", {1, out.channels, out.height, out.width});
    return graph_.node(
        name, "Resize", {x, "", "", sizes},
        {{"mode", std::string(bilinear ? "linear" : "nearest")},
         {"coordinate_transformation_mode", std::string(bilinear ? "half_pixel" : "asymmetric")},
         {"nearest_mode", std::string("floor")}});
  }

  std::string reshape(const std::string& name, const std::string& x, const Ints& shape) {
    return graph_.node(name, "Reshape", {x, graph_.integers(name + ".shape", shape)});
  }
  std::string transpose(const std::string& name, const std::string& x, const Ints& order) {
    return graph_.node(name, "Transpose", {x}, {{"perm", order}});
  }
  std::string add(const std::string& name, const std::string& a, const std::string& b) {
    return graph_.node(name, "Add", {a, b});
  }
  std::string multiply(const std::string& name, const std::string& a, const std::string& b) {
    return graph_.node(name, "Mul", {a, b});
  }

  // The inputs as the layer reads them: upsampled, side by side.
  std::string gather(const Layer& layer) {
    std::vector<std::string> parts;
    for (std::size_t i = 0; i < layer.inputs.size(); ++i) {
      const Upsampling upsampling = layer.inputs[i].upsampling;
      std::string x = value(layer, i);
      if (upsampling != Upsampling::kNone) {
        Shape twice = source(layer, i).output;
        twice.height *= 2;
        twice.width *= 2;
        x = resize(layer.name + ".upsampled", x, twice, upsampling);
      }
      parts.push_back(x);
    }
    if (parts.size() == 1) return parts[0];
    return graph_.node(layer.name + ".joined", "Concat", parts, {{"axis", std::int64_t{1}}});
  }

  std::string convolution(const Layer& layer) {
    std::string x = gather(layer);
    std::int64_t pad = layer.kernel / 2;
    if (layer.padding == Padding::kReflect && pad > 0) {
      const std::string pads =
          graph_.integers(layer.name + ".pads", {0, 0, pad, pad, 0, 0, pad, pad});
      x = graph_.node(layer.name + ".padded", "Pad", {x, pads}, {{"mode", std::string("reflect")}});
      pad = 0;
    }
    std::vector<std::string> inputs = {x, weight(layer, 0)};
    if (layer.parameters.size() > 1) inputs.push_back(weight(layer, 1));
    const std::int64_t groups =
        layer.kind == LayerKind::kDepthwise ? layer.output.channels : std::int64_t{1};
    std::string y = conv_node(layer.name, inputs, layer.kernel, layer.stride, pad, groups);
    if (layer.residual >= 0) y = add(layer.name + ".sum", y, value(layer.residual));
    return activate(layer.name, y, layer.activation);
  }

  std::string conv_node(const std::string& name, const std::vector<std::string>& inputs,
                        std::int64_t kernel, std::int64_t stride, std::int64_t pad,
                        std::int64_t groups) {
    return graph_.node(name, "Conv", inputs,
                       {{"kernel_shape", Ints{kernel, kernel}},
                        {"strides", Ints{stride, stride}},
                        {"pads", Ints{pad, pad, pad, pad}},
                        {"group", groups}});
  }

  // The file holds [out, in]; MatMul wants [in, out].
  std::string linear(const Layer& layer) {
    const Parameter& parameter = layer.parameters[0];
    const auto out = static_cast<std::size_t>(parameter.shape[0]);
    const auto in = static_cast<std::size_t>(parameter.shape[1]);
    const std::vector<float> rows = read(parameter);
    std::vector<float> columns(rows.size());
    for (std::size_t o = 0; o < out; ++o) {
      for (std::size_t i = 0; i < in; ++i) columns[i * out + o] = rows[o * in + i];
    }
    const std::string w =
        graph_.constant(parameter.name, {parameter.shape[1], parameter.shape[0]}, columns);
    std::string y = graph_.node(layer.name + ".product", "MatMul", {value(layer, 0), w});
    y = add(layer.name, y, weight(layer, 1));
    if (layer.residual >= 0) y = add(layer.name + ".sum", y, value(layer.residual));
    return activate(layer.name, y, layer.activation);
  }

  // [1, C, h, w] -> [4, h/2 * w/2, C], one sequence per position in a 2x2 patch, and back.
  std::string unfold(const Layer& layer) {
    const Shape& in = source(layer, 0).output;
    const std::string split = reshape(layer.name + ".split", value(layer, 0),
                                      {in.channels, in.height / 2, 2, in.width / 2, 2});
    const std::string ordered = transpose(layer.name + ".ordered", split, {2, 4, 1, 3, 0});
    return reshape(layer.name, ordered, {4, layer.output.width, in.channels});
  }
  std::string fold(const Layer& layer) {
    const Shape& out = layer.output;
    const std::string split = reshape(layer.name + ".split", value(layer, 0),
                                      {2, 2, out.height / 2, out.width / 2, out.channels});
    const std::string ordered = transpose(layer.name + ".ordered", split, {4, 2, 0, 3, 1});
    return reshape(layer.name, ordered, {1, out.channels, out.height, out.width});
  }

  std::string attention(const Layer& layer) {
    const std::string& name = layer.name;
    const std::int64_t tokens = layer.output.width;
    const std::int64_t channels = layer.output.channels;
    const std::int64_t head = channels / Network::kHeads;
    const std::string split =
        reshape(name + ".split", value(layer, 0), {4, tokens, 3, Network::kHeads, head});
    const auto part = [&](const char* which, std::int64_t index, const Ints& order) {
      const std::string suffix = std::string(".") + which;
      const std::string picked = graph_.node(
          name + suffix + ".picked", "Gather",
          {split, graph_.integer(name + suffix + ".index", index)}, {{"axis", std::int64_t{2}}});
      return transpose(name + suffix, picked, order);
    };
    const std::string q = part("q", 0, {0, 2, 1, 3});
    const std::string k = part("k", 1, {0, 2, 3, 1});
    const std::string v = part("v", 2, {0, 2, 1, 3});
    const std::string scale =
        graph_.scalar(name + ".scale", 1 / std::sqrt(static_cast<float>(head)));
    const std::string scores =
        graph_.node(name + ".scores", "MatMul", {multiply(name + ".q.scaled", q, scale), k});
    const std::string weights =
        graph_.node(name + ".weights", "Softmax", {scores}, {{"axis", std::int64_t{-1}}});
    const std::string mixed = graph_.node(name + ".mixed", "MatMul", {weights, v});
    return reshape(name, transpose(name + ".ordered", mixed, {0, 2, 1, 3}), {4, tokens, channels});
  }

  std::string start(const Layer& layer) {
    std::vector<float> x(layer.output.count(), 0.0F);
    if (network_.config().start == StartKind::kNoise) fill_gaussian(network_.config().seed, x);
    return graph_.constant(layer.name, {1, 1, layer.output.height, layer.output.width}, x);
  }

  // conv1(condition + time + embed(x)) as a runtime would be given it: the time in embed's bias,
  // the scale in conv1's weight, nothing shared between the steps.
  std::string head_hidden(const Layer& layer) {
    const std::string& name = layer.name;
    const Layer& shared = source(layer, 0);
    const std::string embedded = conv_node(
        name + ".embedded", {value(layer, 1), weight(layer, 0), weight(layer, 1)}, 3, 1, 1, 1);
    const std::string fused = add(name + ".fused", value(shared, 0), embedded);
    std::vector<float> scaled = read(layer.parameters[2]);
    const std::vector<float> scale = read(layer.parameters[3]);
    const std::size_t filter = scaled.size() / scale.size();
    for (std::size_t i = 0; i < scaled.size(); ++i) scaled[i] *= scale[i / filter];
    const std::string conv1 = graph_.constant(name + ".weight", layer.parameters[2].shape, scaled);
    const std::string y = conv_node(name, {fused, conv1, weight(layer, 4)}, 3, 1, 1, 1);
    return activate(name, y, layer.activation);
  }

  std::string group_norm(const Layer& layer) {
    const std::string& name = layer.name;
    const Shape& s = layer.output;
    const std::vector<float> one(Network::kGroups, 1.0F);
    const std::vector<float> zero(Network::kGroups, 0.0F);
    const std::string groups =
        reshape(name + ".groups", value(layer, 0), {1, Network::kGroups, -1});
    const std::string normed =
        graph_.node(name + ".normed", "InstanceNormalization",
                    {groups, graph_.constant(name + ".one", {Network::kGroups}, one),
                     graph_.constant(name + ".zero", {Network::kGroups}, zero)},
                    {{"epsilon", Network::kNormEpsilon}});
    const std::string image = reshape(name + ".image", normed, {1, s.channels, s.height, s.width});
    const auto per_channel = [&](std::size_t index) {
      const std::string as = name + (index == 0 ? ".weight" : ".bias");
      return graph_.constant(as, {1, s.channels, 1, 1}, read(layer.parameters[index]));
    };
    const std::string scaled = multiply(name + ".scaled", image, per_channel(0));
    return activate(name, add(name, scaled, per_channel(1)), layer.activation);
  }

  // x <- p x + q conv2(h).
  std::string update(const Layer& layer) {
    const SamplerStep step = make_sampler(network_.config())[static_cast<std::size_t>(layer.step)];
    const std::string& name = layer.name;
    const std::string out =
        conv_node(name + ".out", {value(layer, 0), weight(layer, 0), weight(layer, 1)}, 3, 1, 1, 1);
    const std::string p = graph_.scalar(name + ".p", static_cast<float>(step.p));
    const std::string q = graph_.scalar(name + ".q", static_cast<float>(step.q));
    return add(name, multiply(name + ".kept", value(layer, 1), p),
               multiply(name + ".moved", out, q));
  }

  // 1 / (1 / farthest + (1 / nearest - 1 / farthest) sigmoid(logit)).
  std::string depth(const Layer& layer) {
    const ModelConfig& config = network_.config();
    const auto constant = [&](const char* suffix, double value) {
      return graph_.scalar(layer.name + suffix, static_cast<float>(value));
    };
    std::string y =
        multiply("logit.scaled", value(layer, 0), constant(".std", config.variable_std));
    y = graph_.node("disparity", "Sigmoid",
                    {add("logit", y, constant(".mean", config.variable_mean))});
    y = multiply("disparity.scaled", y, constant(".range", 1 / kMinDepth - 1 / kMaxDepth));
    y = add("disparity.metric", y, constant(".least", 1 / kMaxDepth));
    return graph_.node(layer.name, "Reciprocal", {y});
  }

  const Network& network_;
  const ModelFile& file_;
  OnnxGraph& graph_;
  std::vector<std::string> values_;  // by layer
  std::set<std::string> written_;
};

}  // namespace

Status export_onnx(const ModelFile& file, int width, int height, const std::string& path) {
  const Result<Network> network = Network::build(file.config(), width, height);
  if (!network) return network.status();
  LCDM_RETURN_IF_ERROR(network->check_weights(file));
  OnnxGraph graph;
  Exporter(*network, file, graph).run();
  return graph.save(path);
}

}  // namespace lcdm::model
