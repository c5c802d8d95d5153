#include "model/meter_encoder.h"

#include <cmath>
#include <map>
#include <vector>

#include "model/network.h"
#include "model/onnx_weights.h"

namespace lcdm::model {
namespace {

using Shape = std::vector<std::int64_t>;

constexpr double kNormEpsilon = 1e-5;
// Channels before and after each inverted residual, its stride, and of each block its channels,
// dimension and hidden width.
constexpr int kResiduals[7][3] = {{16, 16, 1}, {16, 24, 2}, {24, 24, 1}, {24, 24, 1},
                                  {24, 48, 2}, {48, 64, 2}, {64, 80, 2}};
constexpr int kBlocks[3][3] = {{48, 64, 128}, {64, 80, 320}, {80, 96, 384}};
constexpr int kFinal = 160;

// Takes tensors out of the file by operator, and remembers the first that does not fit.
class Source {
 public:
  explicit Source(const std::string& path) : path_(path) {}

  Status read() {
    auto weights = read_onnx_weights(path_);
    if (!weights) return weights.status();
    weights_ = std::move(*weights);
    return Status::ok();
  }

  // Constant input `index` of `operation`.
  torch::Tensor take(const std::string& operation, std::size_t index, const Shape& shape) {
    const auto found = weights_.find(operation);
    if (found != weights_.end() && index < found->second.size() &&
        found->second[index].sizes() == shape) {
      return found->second[index];
    }
    if (status_) {
      status_ = Status::error(StatusCode::kInvalidInput,
                              "%s: not METER-XXS with its operators' names (%s)", path_.c_str(),
                              operation.c_str());
    }
    return torch::zeros(shape);
  }
  MeterConvolution convolution(const std::string& name, const Shape& shape) {
    return {take(name + "/Conv", 0, shape), take(name + "/Conv", 1, {shape[0]})};
  }
  // Its "separable" convolution: a dense 3x3 one, then a pointwise one with the norm.
  MeterConvolution separable(const std::string& name, int in, int out) {
    const torch::Tensor dense = take(name + "/depthwise/Conv", 0, {out, in, 3, 3});
    const MeterConvolution pointwise = convolution(name + "/pointwise", {out, out, 1, 1});
    return {torch::matmul(pointwise.weight.flatten(1), dense.flatten(1)).reshape({out, in, 3, 3}),
            pointwise.bias};
  }
  const Status& status() const { return status_; }

 private:
  std::string path_;
  std::map<std::string, std::vector<torch::Tensor>> weights_;
  Status status_ = Status::ok();
};

MeterInvertedResidual read_residual(Source& source, std::size_t number) {
  const auto [in, out, stride] = kResiduals[number];
  const std::string name = "/encoder/mv2." + std::to_string(number) + "/conv/conv.";
  const int hidden = 2 * in;
  return {source.convolution(name + "0", {hidden, in, 1, 1}),
          source.convolution(name + "3", {hidden, 1, 3, 3}),
          source.convolution(name + "6", {out, hidden, 1, 1})};
}

MeterVitBlock read_block(Source& source, std::size_t number) {
  const auto [channels, dim, hidden] = kBlocks[number];
  constexpr std::int64_t kInner = MeterVitBlock::kHeads * MeterVitBlock::kHeadDim;
  const std::string name = "/encoder/mvit." + std::to_string(number);
  const std::string attention = name + "/transformer/layers.0.0";
  const std::string feed_forward = name + "/transformer/layers.0.1";
  MeterVitBlock out;
  out.conv_kxk = source.separable(name + "/conv1/conv1.0", channels, channels);
  out.conv_1x1 = source.convolution(name + "/conv2/conv2.0", {dim, channels, 1, 1});
  out.norm1 = {source.take(attention + "/norm/Mul", 0, {dim}),
               source.take(attention + "/norm/Add_1", 0, {dim})};
  out.qkv = source.take(attention + "/fn/to_qkv/MatMul", 0, {dim, 3 * kInner});
  out.proj = source.take(attention + "/fn/to_out/to_out.0/MatMul", 0, {kInner, dim});
  out.proj_bias = source.take(attention + "/fn/to_out/to_out.0/Add", 0, {dim});
  out.norm2 = {source.take(feed_forward + "/norm/Mul", 0, {dim}),
               source.take(feed_forward + "/norm/Add_1", 0, {dim})};
  out.fc1 = source.take(feed_forward + "/fn/net/net.0/MatMul", 0, {dim, hidden});
  out.fc1_bias = source.take(feed_forward + "/fn/net/net.0/Add", 0, {hidden});
  out.fc2 = source.take(feed_forward + "/fn/net/net.3/MatMul", 0, {hidden, dim});
  out.fc2_bias = source.take(feed_forward + "/fn/net/net.3/Add", 0, {dim});
  out.conv_proj = source.convolution(name + "/conv3/conv3.0", {channels, dim, 1, 1});
  out.fusion = source.separable(name + "/conv4/conv4.0", 2 * channels, channels);
  return out;
}

torch::Tensor convolve(const MeterConvolution& conv, const torch::Tensor& x, int stride = 1) {
  const std::int64_t groups = x.size(1) / conv.weight.size(1);
  return torch::conv2d(x, conv.weight, conv.bias, stride, conv.weight.size(2) / 2, 1, groups);
}

torch::Tensor forward(const MeterInvertedResidual& block, const torch::Tensor& x, int stride) {
  torch::Tensor y = torch::relu(convolve(block.expand, x));
  y = convolve(block.project, torch::relu(convolve(block.depthwise, y, stride)));
  return stride == 1 && y.size(1) == x.size(1) ? x + y : y;
}

torch::Tensor normalise(const MeterNorm& norm, const torch::Tensor& tokens) {
  return torch::layer_norm(tokens, {tokens.size(2)}, norm.weight, norm.bias, kNormEpsilon);
}

torch::Tensor attend(const MeterVitBlock& block, const torch::Tensor& tokens) {
  constexpr std::int64_t kHeads = MeterVitBlock::kHeads;
  constexpr std::int64_t kHeadDim = MeterVitBlock::kHeadDim;
  const std::int64_t sequences = tokens.size(0);
  const std::int64_t length = tokens.size(1);
  const torch::Tensor parts = torch::matmul(normalise(block.norm1, tokens), block.qkv)
                                  .reshape({sequences, length, 3, kHeads, kHeadDim})
                                  .permute({2, 0, 3, 1, 4});
  const torch::Tensor weights = torch::softmax(torch::matmul(parts[0], parts[1].transpose(-2, -1)) /
                                                   std::sqrt(static_cast<double>(kHeadDim)),
                                               -1);
  const torch::Tensor seen = torch::matmul(weights, parts[2]).transpose(1, 2);
  return torch::matmul(seen.reshape({sequences, length, kHeads * kHeadDim}), block.proj) +
         block.proj_bias;
}

torch::Tensor forward(const MeterVitBlock& block, const torch::Tensor& x) {
  const torch::Tensor local = torch::relu(convolve(block.conv_kxk, x));
  torch::Tensor tokens = unfold_patches(torch::relu(convolve(block.conv_1x1, local)));
  tokens = tokens + attend(block, tokens);
  const torch::Tensor hidden =
      torch::relu(torch::matmul(normalise(block.norm2, tokens), block.fc1) + block.fc1_bias);
  tokens = tokens + torch::matmul(hidden, block.fc2) + block.fc2_bias;
  const torch::Tensor y = fold_patches(tokens, x.size(0), x.size(2), x.size(3));
  const torch::Tensor transformed = torch::relu(convolve(block.conv_proj, y));
  return torch::relu(convolve(block.fusion, torch::cat({transformed, x}, 1)));
}

}  // namespace

MeterFeatures MeterEncoder::forward(const torch::Tensor& rgb) const {
  std::array<torch::Tensor, 7> after;  // each inverted residual
  torch::Tensor x = torch::relu(convolve(stem, scale_pixels(rgb, pixels), 2));
  const auto pass = [&](std::size_t number) {
    x = after[number] = model::forward(residuals[number], x, kResiduals[number][2]);
  };
  MeterFeatures out;
  for (std::size_t number = 0; number < 4; ++number) pass(number);
  out.taps[0] = after[0];
  out.taps[1] = after[3];
  for (std::size_t i = 0; i < blocks.size(); ++i) {
    pass(4 + i);
    x = model::forward(blocks[i], x);
    if (i < 2) out.taps[2 + i] = x;
  }
  out.taps[4] = torch::relu(convolve(final_conv, x));
  out.skips = {after[1], after[4], after[5]};
  return out;
}

Result<MeterEncoder> read_meter_encoder(const std::string& path, const PixelScale& pixels) {
  Source source(path);
  LCDM_RETURN_IF_ERROR(source.read());
  MeterEncoder encoder;
  encoder.pixels = pixels;
  encoder.stem = source.separable("/encoder/conv1/conv1.0", 3, 16);
  for (std::size_t i = 0; i < encoder.residuals.size(); ++i) {
    encoder.residuals[i] = read_residual(source, i);
  }
  for (std::size_t i = 0; i < encoder.blocks.size(); ++i) {
    encoder.blocks[i] = read_block(source, i);
  }
  encoder.final_conv = source.convolution("/encoder/conv2/conv2.0", {kFinal, kBlocks[2][0], 1, 1});
  if (!source.status()) return source.status();
  return encoder;
}

}  // namespace lcdm::model
