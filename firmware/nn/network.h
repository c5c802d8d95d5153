// The forward pass written once, as data: a list of typed layers made from the model's
// configuration. Weight check, memory plan, lowering, operation count and `inspect` all read it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/nn/model_file.h"
#include "firmware/nn/network_config.h"

namespace lcdm {

// Channels are innermost in memory (NHWC, one image). A sequence of tokens is [positions, tokens,
// channels]: height is the position inside a patch, width counts the patches.
struct Shape {
  int height = 0;
  int width = 0;
  int channels = 0;

  std::size_t count() const {
    return static_cast<std::size_t>(height) * static_cast<std::size_t>(width) *
           static_cast<std::size_t>(channels);
  }
  bool operator==(const Shape&) const = default;
};

enum class LayerKind : std::uint8_t {
  kInput,       // the normalised picture
  kConv,        // 1x1 or 3x3 over the concatenation of its inputs; + residual; activation
  kDepthwise,   // 3x3, one filter per channel; activation
  kLinear,      // over the channels of each token; + residual; activation
  kResize,      // bilinear, align_corners false, to any size
  kUnfold,      // image to tokens of 2x2 patches
  kFold,        // and back
  kLayerNorm,   // over the channels of each token
  kAttention,   // multi-head, within each position; input is q, k, v side by side
  kStart,       // the sampler's start, made once at prepare
  kHeadHidden,  // conv1(condition + time + embed(x)), scale, bias and activation; reads
                // conv1(condition), which all steps share, and x
  kGroupNorm,   // 4 groups; activation
  kUpdate,      // conv 3x3 to one channel and x <- p x + q out
  kDepth,       // logit to depth in metres
};

const char* to_string(LayerKind kind);

enum class Activation : std::uint8_t { kNone, kSilu, kElu, kRelu };
enum class Padding : std::uint8_t { kZero, kReflect };
enum class Upsampling : std::uint8_t { kNone, kNearest, kBilinear };  // x2, while it is read

// What products multiply: those of 1x1 convolutions, of linear layers, of attention and of 3x3
// convolutions where Winograd's algorithm is not faster. They add in float (kInt8: exactly). From
// the most exact on: where the processor or a layer cannot have one, it has the next above.
// Activations are rough beside narrow products. What projects the first block stays in float, and
// beside fp16, or int8 without bf16, all of that block.
enum class Precision : std::uint8_t {
  kFloat32,
  kFloat16,  // adds some products in half precision, those sums in float
  kBfloat16,
  kInt8,  // weights with a scale for each column, activations with a range for some pixels
          // together; attention in kBfloat16 or kFloat16 where the processor has it, else float
};

inline constexpr Precision kPrecisions[] = {Precision::kFloat32, Precision::kFloat16,
                                            Precision::kBfloat16, Precision::kInt8};

const char* to_string(Precision precision);
// The precision that to_string calls so, if there is one.
std::optional<Precision> parse_precision(std::string_view name);

// The output of an earlier layer, as a later one reads it.
struct Source {
  int layer = -1;
  Upsampling upsampling = Upsampling::kNone;
};

// A tensor the model file must hold, and its shape there.
struct Parameter {
  std::string name;
  std::vector<std::int64_t> shape;
};

struct Layer {
  LayerKind kind = LayerKind::kInput;
  std::string name;  // NETWORK.md's module name, with which tests find the output
  std::vector<Source> inputs =
      {};             // kConv concatenates them; kHeadHidden: shared, x; kUpdate: h, x
  int residual = -1;  // layer whose output is added before the activation, or -1
  Shape output = {};
  int kernel = 1;
  int stride = 1;
  Padding padding = Padding::kZero;
  Activation activation = Activation::kNone;
  int step = -1;  // sampler step of kHeadHidden and kUpdate
  std::vector<Parameter> parameters =
      {};                 // in the order weight, bias (kHeadHidden: embed's, conv1's with scale)
  std::int64_t macs = 0;  // multiply-adds
  bool stored = true;     // false: made row by row inside the one layer that reads it
};

class Network {
 public:
  static constexpr int kSizeStep = 32;  // width and height are multiples of it
  static constexpr int kMinSide = 64;
  static constexpr int kMaxSide = 2048;
  static constexpr bool is_side(int side) {
    return side >= kMinSide && side <= kMaxSide && side % kSizeStep == 0;
  }
  static constexpr int kHeads = 4;
  static constexpr int kGroups = 4;
  static constexpr float kNormEpsilon = 1e-5F;

  // kInvalidInput where the size is not possible.
  static Result<Network> build(const ModelConfig& config, int width, int height);

  const ModelConfig& config() const { return config_; }
  int width() const { return width_; }
  int height() const { return height_; }
  // In order of execution; the first is the input, the last the depth.
  const std::vector<Layer>& layers() const { return layers_; }
  const Layer& layer(int index) const { return layers_[static_cast<std::size_t>(index)]; }
  // Index of the layer called `name`, or -1.
  int find(std::string_view name) const;
  std::int64_t macs() const;

  // The file holds exactly the tensors the layers name, in their shapes. kInvalidInput otherwise,
  // naming the first tensor that is wrong, its shape and the expected one.
  Status check_weights(const ModelFile& model) const;

 private:
  Network(const ModelConfig& config, int width, int height)
      : config_(config), width_(width), height_(height) {}

  ModelConfig config_;
  int width_;
  int height_;
  std::vector<Layer> layers_;
};

}  // namespace lcdm
