#include "firmware/nn/network.h"

#include <array>
#include <set>

namespace lcdm {
namespace {

constexpr int kStemChannels = 16;
constexpr int kEarlyBlocks = 3;  // of stage 1

int round_up_to_even(int value) { return value + value % 2; }

class Builder {
 public:
  Builder(const ModelConfig& config, int width, int height, std::vector<Layer>& layers)
      : config_(config), width_(width), height_(height), layers_(layers) {}

  void build() {
    const bool paper = config_.preset == PresetKind::kPaper;
    padding_ = paper ? Padding::kReflect : Padding::kZero;
    upsampling_ = paper ? Upsampling::kNearest : Upsampling::kBilinear;
    const int condition = decoder(encoder(input()));
    depth(sample(condition));
  }

 private:
  const Shape& shape(int layer) const { return layers_[static_cast<std::size_t>(layer)].output; }

  int add(Layer layer) {
    layers_.push_back(std::move(layer));
    return static_cast<int>(layers_.size()) - 1;
  }

  int input() {
    return add({.kind = LayerKind::kInput, .name = "input", .output = {height_, width_, 3}});
  }

  // ---- the operators ----

  struct ConvOptions {
    int kernel = 3;
    int stride = 1;
    Activation activation = Activation::kNone;
    Padding padding = Padding::kZero;
    int residual = -1;
    bool bias = true;
  };

  int conv(const std::string& name, std::vector<Source> inputs, int channels,
           const ConvOptions& o) {
    const Source& first = inputs.front();
    const int scale = first.upsampling == Upsampling::kNone ? 1 : 2;
    const Shape in = shape(first.layer);
    int in_channels = 0;
    for (const Source& source : inputs) in_channels += shape(source.layer).channels;
    const Shape out = {in.height * scale / o.stride, in.width * scale / o.stride, channels};
    Layer layer{.kind = LayerKind::kConv,
                .name = name,
                .inputs = std::move(inputs),
                .residual = o.residual,
                .output = out,
                .kernel = o.kernel,
                .stride = o.stride,
                .padding = o.padding,
                .activation = o.activation};
    layer.parameters.push_back({name + ".weight", {channels, in_channels, o.kernel, o.kernel}});
    if (o.bias) layer.parameters.push_back({name + ".bias", {channels}});
    layer.macs = static_cast<std::int64_t>(out.count()) * in_channels * o.kernel * o.kernel;
    return add(std::move(layer));
  }

  int depthwise(const std::string& name, int x, int stride) {
    const Shape in = shape(x);
    const Shape out = {in.height / stride, in.width / stride, in.channels};
    return add({.kind = LayerKind::kDepthwise,
                .name = name,
                .inputs = {{x}},
                .output = out,
                .kernel = 3,
                .stride = stride,
                .activation = Activation::kSilu,
                .parameters = {{name + ".weight", {in.channels, 1, 3, 3}},
                               {name + ".bias", {in.channels}}},
                .macs = static_cast<std::int64_t>(out.count()) * 9});
  }

  int linear(const std::string& name, int x, int channels, Activation activation, int residual) {
    const Shape in = shape(x);
    const Shape out = {in.height, in.width, channels};
    return add(
        {.kind = LayerKind::kLinear,
         .name = name,
         .inputs = {{x}},
         .residual = residual,
         .output = out,
         .activation = activation,
         .parameters = {{name + ".weight", {channels, in.channels}}, {name + ".bias", {channels}}},
         .macs = static_cast<std::int64_t>(out.count()) * in.channels});
  }

  int layer_norm(const std::string& name, int x) {
    const int channels = shape(x).channels;
    return add({.kind = LayerKind::kLayerNorm,
                .name = name,
                .inputs = {{x}},
                .output = shape(x),
                .parameters = {{name + ".weight", {channels}}, {name + ".bias", {channels}}}});
  }

  int attention(const std::string& name, int qkv) {
    const Shape in = shape(qkv);
    const Shape out = {in.height, in.width, in.channels / 3};
    return add({.kind = LayerKind::kAttention,
                .name = name,
                .inputs = {{qkv}},
                .output = out,
                .macs = static_cast<std::int64_t>(out.count()) * in.width * 2});
  }

  int reshape(LayerKind kind, const std::string& name, int x, const Shape& out) {
    return add({.kind = kind, .name = name, .inputs = {{x}}, .output = out});
  }

  // ---- MobileViT ----

  int mv2(const std::string& name, int x, int channels, int stride, int ratio) {
    const int in_channels = shape(x).channels;
    const int residual = stride == 1 && in_channels == channels ? x : -1;
    int y = conv(name + ".conv1_1x1", {{x}}, in_channels * ratio,
                 {.kernel = 1, .activation = Activation::kSilu});
    layers_[static_cast<std::size_t>(y)].stored = false;
    y = depthwise(name + ".conv2_kxk", y, stride);
    layers_[static_cast<std::size_t>(y)].stored = false;
    return conv(name + ".conv3_1x1", {{y}}, channels, {.kernel = 1, .residual = residual});
  }

  int transformer(const std::string& name, int x) {
    const int dim = shape(x).channels;
    int y = layer_norm(name + ".norm1", x);
    y = linear(name + ".attn.qkv", y, 3 * dim, Activation::kNone, -1);
    y = attention(name + ".attn", y);
    x = linear(name + ".attn.proj", y, dim, Activation::kNone, x);
    y = layer_norm(name + ".norm2", x);
    y = linear(name + ".mlp.fc1", y, 2 * dim, Activation::kSilu, -1);
    return linear(name + ".mlp.fc2", y, dim, Activation::kNone, x);
  }

  int mobilevit(const std::string& name, int x, const EncoderTable::VitStage& stage) {
    int y = conv(name + ".conv_kxk", {{x}}, stage.channels, {.activation = Activation::kSilu});
    y = conv(name + ".conv_1x1", {{y}}, stage.dim, {.kernel = 1, .bias = false});
    const Shape image = shape(y);
    const Shape even = {round_up_to_even(image.height), round_up_to_even(image.width), stage.dim};
    if (even != image) y = reshape(LayerKind::kResize, name + ".resize_up", y, even);
    const Shape tokens = {4, even.height / 2 * (even.width / 2), stage.dim};
    y = reshape(LayerKind::kUnfold, name + ".unfold", y, tokens);
    for (int j = 0; j < stage.depth; ++j) {
      y = transformer(name + ".transformer." + std::to_string(j), y);
    }
    y = layer_norm(name + ".norm", y);
    y = reshape(LayerKind::kFold, name + ".fold", y, even);
    if (even != image) y = reshape(LayerKind::kResize, name + ".resize_back", y, image);
    y = conv(name + ".conv_proj", {{y}}, stage.channels,
             {.kernel = 1, .activation = Activation::kSilu});
    return conv(name + ".conv_fusion", {{x}, {y}}, stage.channels,
                {.activation = Activation::kSilu});
  }

  // The five taps, finest first.
  std::array<int, 5> encoder(int x) {
    const EncoderTable table = encoder_table(config_.encoder);
    std::array<int, 5> taps{};
    x = conv("encoder.stem", {{x}}, kStemChannels, {.stride = 2, .activation = Activation::kSilu});
    taps[0] = x = mv2("encoder.stages.0.0", x, table.early[0], 1, table.ratio);
    for (int j = 0; j < kEarlyBlocks; ++j) {
      x = mv2("encoder.stages.1." + std::to_string(j), x, table.early[1], j == 0 ? 2 : 1,
              table.ratio);
    }
    taps[1] = x;
    for (std::size_t i = 2; i < 5; ++i) {
      const std::string stage = "encoder.stages." + std::to_string(i);
      x = mv2(stage + ".0", x, table.late[i - 2].channels, 2, table.ratio);
      taps[i] = x = mobilevit(stage + ".1", x, table.late[i - 2]);
    }
    taps[4] = conv("encoder.final_conv", {{x}}, table.final_channels,
                   {.kernel = 1, .activation = Activation::kSilu});
    return taps;
  }

  // ---- decoder, head, sampler ----

  int conv_block(const std::string& name, std::vector<Source> inputs, int channels) {
    return conv(name, std::move(inputs), channels,
                {.activation = Activation::kElu, .padding = padding_});
  }

  int decoder(const std::array<int, 5>& taps) {
    int x = taps[4];
    for (std::size_t i = 5; i-- > 0;) {
      const std::string name = "decoder.upconv_" + std::to_string(i);
      const int width = config_.decoder_widths[i];
      x = conv_block(name + "_0", {{x}}, width);
      std::vector<Source> inputs = {{x, upsampling_}};
      if (i > 0) inputs.push_back({taps[i - 1]});
      x = conv_block(name + "_1", std::move(inputs), width);
    }
    // At full resolution each layer is made row by row inside the next; a reflected border asks for
    // rows out of order.
    const bool stored = padding_ == Padding::kReflect;
    layers_[static_cast<std::size_t>(x)].stored = stored;
    x = conv_block("decoder.condition", {{x}}, config_.condition_channels);
    layers_[static_cast<std::size_t>(x)].stored = stored;
    return x;
  }

  int sample(int condition) {
    const Shape plane = {height_, width_, 1};
    int x = add({.kind = LayerKind::kStart, .name = "head.start", .output = plane});
    const int shared =
        conv("head.conv1", {{condition}}, config_.condition_channels, {.bias = false});
    for (int k = 0; k < static_cast<int>(config_.steps.size()); ++k) x = head(k, shared, x);
    return x;
  }

  int head(int k, int shared, int x) {
    const Shape wide = shape(shared);
    const int c = wide.channels;
    const bool group_norm = config_.preset == PresetKind::kPaper;
    const std::string name = "head." + std::to_string(k);
    const std::string step = "head.steps." + std::to_string(k);
    // Counted as if each step did all of conv1; the shared layer has the first's.
    const std::int64_t again = k > 0 ? c : 0;
    int h = add({.kind = LayerKind::kHeadHidden,
                 .name = name + ".conv1",
                 .inputs = {{shared}, {x}},
                 .output = wide,
                 .kernel = 3,
                 .activation = group_norm ? Activation::kNone : Activation::kRelu,
                 .step = k,
                 .parameters = {{"head.embed.weight", {c, 1, 3, 3}},
                                {step + ".embed.bias", {c}},
                                {"head.conv1.weight", {c, c, 3, 3}},
                                {step + ".conv1.scale", {c}},
                                {step + ".conv1.bias", {c}}},
                 .macs = static_cast<std::int64_t>(wide.count()) * 9 * (again + 1),
                 .stored = group_norm});
    if (group_norm) {
      h = add({.kind = LayerKind::kGroupNorm,
               .name = name + ".norm",
               .inputs = {{h}},
               .output = wide,
               .activation = Activation::kRelu,
               .parameters = {{"head.norm.weight", {c}}, {"head.norm.bias", {c}}}});
    }
    return add({.kind = LayerKind::kUpdate,
                .name = name,
                .inputs = {{h}, {x}},
                .output = shape(x),
                .kernel = 3,
                .step = k,
                .parameters = {{"head.conv2.weight", {1, c, 3, 3}}, {"head.conv2.bias", {1}}},
                .macs = static_cast<std::int64_t>(wide.count()) * 9});
  }

  void depth(int x) {
    add({.kind = LayerKind::kDepth, .name = "depth", .inputs = {{x}}, .output = shape(x)});
  }

  const ModelConfig& config_;
  int width_;
  int height_;
  std::vector<Layer>& layers_;
  Padding padding_ = Padding::kZero;
  Upsampling upsampling_ = Upsampling::kBilinear;
};

std::string shape_text(const std::vector<std::int64_t>& shape) {
  std::string text = "[";
  for (const std::int64_t extent : shape) {
    if (text.size() > 1) text += ", ";
    text += std::to_string(extent);
  }
  return text + "]";
}

}  // namespace

const char* to_string(LayerKind kind) {
  switch (kind) {
    case LayerKind::kInput:
      return "input";
    case LayerKind::kConv:
      return "conv";
    case LayerKind::kDepthwise:
      return "depthwise";
    case LayerKind::kLinear:
      return "linear";
    case LayerKind::kResize:
      return "resize";
    case LayerKind::kUnfold:
      return "unfold";
    case LayerKind::kFold:
      return "fold";
    case LayerKind::kLayerNorm:
      return "layer norm";
    case LayerKind::kAttention:
      return "attention";
    case LayerKind::kStart:
      return "start";
    case LayerKind::kHeadHidden:
      return "hidden";
    case LayerKind::kGroupNorm:
      return "group norm";
    case LayerKind::kUpdate:
      return "update";
    case LayerKind::kDepth:
      return "depth";
  }
  return "unknown";
}

const char* to_string(Precision precision) {
  switch (precision) {
    case Precision::kFloat32:
      return "fp32";
    case Precision::kFloat16:
      return "fp16";
    case Precision::kBfloat16:
      return "bf16";
    case Precision::kInt8:
      return "int8";
  }
  return "unknown";
}

std::optional<Precision> parse_precision(std::string_view name) {
  for (const Precision each : kPrecisions) {
    if (name == to_string(each)) return each;
  }
  return std::nullopt;
}

Result<Network> Network::build(const ModelConfig& config, int width, int height) {
  if (!is_side(width) || !is_side(height)) {
    return Status::error(StatusCode::kInvalidInput,
                         "network size %dx%d: choose multiples of %d from %d to %d", width, height,
                         kSizeStep, kMinSide, kMaxSide);
  }
  Network network(config, width, height);
  Builder(network.config_, width, height, network.layers_).build();
  return network;
}

int Network::find(std::string_view name) const {
  for (std::size_t i = 0; i < layers_.size(); ++i) {
    if (layers_[i].name == name) return static_cast<int>(i);
  }
  return -1;
}

std::int64_t Network::macs() const {
  std::int64_t sum = 0;
  for (const Layer& layer : layers_) sum += layer.macs;
  return sum;
}

Status Network::check_weights(const ModelFile& model) const {
  std::set<std::string_view> known;
  for (const Layer& layer : layers_) {
    for (const Parameter& parameter : layer.parameters) {
      known.insert(parameter.name);
      const auto found = model.tensors().find(parameter.name);
      if (found == model.tensors().end()) {
        return Status::error(StatusCode::kInvalidInput,
                             "model: tensor `%s` %s is missing: export the model again",
                             parameter.name.c_str(), shape_text(parameter.shape).c_str());
      }
      if (found->second.shape != parameter.shape) {
        return Status::error(StatusCode::kInvalidInput,
                             "model: tensor `%s` is %s, expected %s: export the model again",
                             parameter.name.c_str(), shape_text(found->second.shape).c_str(),
                             shape_text(parameter.shape).c_str());
      }
    }
  }
  for (const auto& [name, tensor] : model.tensors()) {
    if (known.count(name) == 0) {
      return Status::error(StatusCode::kInvalidInput,
                           "model: tensor `%.80s` %s is not part of this network: export the model "
                           "again",
                           name.c_str(), shape_text(tensor.shape).c_str());
    }
  }
  return Status::ok();
}

}  // namespace lcdm
