#include "app/commands/bench_kernel_cases.h"

#include <algorithm>
#include <utility>

#include "firmware/nn/kernels/attention.h"
#include "firmware/nn/kernels/conv.h"
#include "firmware/nn/kernels/head.h"
#include "firmware/nn/kernels/inverted_residual.h"
#include "firmware/nn/kernels/matrix.h"
#include "firmware/nn/kernels/norm.h"
#include "firmware/nn/kernels/reshape.h"
#include "firmware/nn/kernels/row_winograd.h"
#include "firmware/nn/kernels/winograd.h"
#include "firmware/vision/camera_model.h"
#include "firmware/vision/depth_to_millimetres.h"
#include "firmware/vision/lens_map.h"
#include "firmware/vision/preprocess.h"

namespace lcdm {
namespace {

using kernels::PackedMatrix;
using kernels::RowInput;

double product(std::initializer_list<int> factors) {
  double all = 1;
  for (const int factor : factors) all *= factor;
  return all;
}
double float_bytes(double count) { return count * sizeof(float); }

// Where the store gives no memory, status() says so and the cases must not be run.
class Cases {
 public:
  explicit Cases(ConstantStore& store) : store_(store) {}

  const Status& status() const { return status_; }

  std::vector<KernelCase> make() {
    for (const Precision precision : kPrecisions) {
      if (kernels::native_precision(precision) != precision) continue;
      matrix(precision);
      inverted_residual("inverted residual 48-192-48, 160x48", {160, 48, 48, 192, 48, 1},
                        precision);
      inverted_residual("inverted residual 32-128-48, 320x96 / 2", {320, 96, 32, 128, 48, 2},
                        precision);
      conv3x3(precision);
      upsampled_conv3x3(precision);
      if (precision != Precision::kInt8) attention(precision);
      if (kernels::head_precision(precision, kHeadChannels) == precision) {
        head(precision, true);
        head(precision, false);
      }
    }
    if (kernels::native_precision(Precision::kInt8) == Precision::kInt8) conv3x3_in_bytes();
    stem();
    reflected_conv3x3();
    winograd();
    layer_norm();
    head_hidden();
    group_norm();
    depth();
    patches();
    resize();
    camera_formats();
    millimetres();
    std::stable_sort(cases_.begin(), cases_.end(),
                     [](const KernelCase& a, const KernelCase& b) { return a.name < b.name; });
    return std::move(cases_);
  }

 private:
  static constexpr int kHeadChannels = 16;

  // Memory of changing small values of either sign.
  std::span<float> floats(double count) {
    const auto size = static_cast<std::size_t>(count);
    Result<std::span<float>> piece = store_.add(size);
    if (!piece) {
      status_ = piece.status();
      return {};
    }
    for (std::size_t i = 0; i < size; ++i) {
      (*piece)[i] = 0.01F * static_cast<float>(static_cast<int>(i * 7919 % 201) - 100);
    }
    return *piece;
  }
  float* values(double count) { return floats(count).data(); }
  const float* stored(const std::vector<float>& numbers) {
    const std::span<float> piece = floats(static_cast<double>(numbers.size()));
    if (piece.size() == numbers.size()) std::copy(numbers.begin(), numbers.end(), piece.begin());
    return piece.data();
  }

  PackedMatrix pack(int depth, int columns, Precision precision = Precision::kFloat32,
                    int runs = 1) {
    const std::span<float> out =
        floats(static_cast<double>(kernels::packed_floats(depth, columns, precision, runs)));
    if (!status_) return {};
    const std::vector<float> bias(static_cast<std::size_t>(columns), 0.1F);
    const auto weight = [depth](int k, int n) {
      return 0.1F * static_cast<float>((k * 31 + n * 17) % 19 - 9) / static_cast<float>(depth);
    };
    return kernels::pack_matrix(depth, columns, weight, bias, out, precision, runs);
  }

  void add(KernelCase made) { cases_.push_back(std::move(made)); }

  void matrix(Precision precision) {
    const int rows = 48 * 160;
    const int depth = 48;
    const int columns = 192;
    const RowInput in = {{values(product({rows, depth}))}, 1, depth, depth, rows};
    const PackedMatrix weights = pack(depth, columns, precision);
    float* out = values(product({rows, columns}));
    add({"1x1 48 -> 192, 160x48", precision, product({rows, depth, columns}),
         float_bytes(product({rows, depth + columns})), [=] {
           kernels::multiply_rows(in, weights, {out, nullptr, columns, Activation::kNone});
         }});
  }

  struct BlockShape {
    int width = 0;  // of the input
    int height = 0;
    int channels = 0;
    int hidden = 0;
    int columns = 0;
    int stride = 1;
  };

  void inverted_residual(const char* name, const BlockShape& shape, Precision precision) {
    kernels::InvertedResidual block;
    block.height = shape.height;
    block.width = shape.width;
    block.channels = shape.channels;
    block.hidden = shape.hidden;
    block.stride = shape.stride;
    const double in = product({block.height, block.width});
    const double out = in / product({block.stride, block.stride});
    block.input = values(in * block.channels);
    block.expand = pack(block.channels, block.hidden, precision);
    if (precision != Precision::kFloat32 &&
        kernels::native_precision(Precision::kBfloat16) == Precision::kBfloat16) {
      block.filter = Precision::kBfloat16;
    }
    const std::span<float> taps = floats(product({9, block.hidden}));
    block.taps = stored(kernels::pack_filter_taps(taps, block.filter));
    block.taps_bias = values(block.hidden);
    block.project = pack(block.hidden, shape.columns, precision);
    block.output = values(out * shape.columns);
    float* scratch = values(static_cast<double>(kernels::inverted_residual_scratch(block)));
    const int rows = block.height / block.stride;
    add({name, precision, block.hidden * (in * block.channels + out * (9 + shape.columns)),
         float_bytes(in * block.channels + out * shape.columns),
         [=] { kernels::inverted_residual_rows(block, 0, rows, scratch); }});
  }

  void attention(Precision precision) {
    kernels::Attention a;
    a.positions = 4;
    a.tokens = 480;
    a.channels = 96;
    a.heads = 4;
    a.precision = precision;
    a.qkv = values(product({a.positions, a.tokens, 3 * a.channels}));
    a.output = values(product({a.positions, a.tokens, a.channels}));
    float* scratch = values(static_cast<double>(kernels::attention_scratch(a)));
    add({"attention 4 x 480 tokens of 96", precision,
         product({a.positions, a.tokens, a.tokens, 2 * a.channels}),
         float_bytes(product({a.positions, a.tokens, 4 * a.channels})),
         [=] { kernels::attention_range(a, 0, kernels::attention_items(a), scratch); }});
  }

  kernels::Conv3x3 image_conv(int width, int height, int channels) {
    kernels::Conv3x3 conv;
    conv.width = width;
    conv.height = height;
    conv.channels = channels;
    conv.inputs[0] = {values(product({width, height, channels})), height, width, channels,
                      Upsampling::kNone};
    return conv;
  }

  void add_conv(const char* name, const kernels::Conv3x3& conv, Precision precision, int channels,
                double in) {
    kernels::ConvChain chain;
    chain.convs[0] = conv;
    chain.count = 1;
    const int rows = conv.height / conv.stride;
    const double pixels = product({rows, conv.width / conv.stride});
    const int columns = conv.weights.columns;
    chain.convs[0].output = values(pixels * columns);
    float* scratch = values(static_cast<double>(kernels::conv3x3_scratch(chain)));
    add({name, precision, pixels * product({9, channels, columns}),
         float_bytes(in + pixels * columns),
         [=] { kernels::conv3x3_rows(chain, 0, rows, scratch); }});
  }

  void stem() {
    kernels::Conv3x3 conv = image_conv(640, 192, 3);
    conv.stride = 2;
    conv.weights = pack(9 * 3, 16);
    add_conv("3x3 3 -> 16, 640x192, stride 2", conv, Precision::kFloat32, 3,
             product({640, 192, 3}));
  }

  // As the engine packs them.
  void pack3x3(kernels::Conv3x3& conv, int columns, Precision precision) {
    conv.row_winograd = kernels::row_winograd_pays(conv.stride, conv.channels, columns, precision);
    const int depth =
        conv.row_winograd ? kernels::row_winograd_depth(conv.channels) : 9 * conv.channels;
    conv.weights = pack(depth, columns, precision, 3);
  }

  void conv3x3(Precision precision) {
    kernels::Conv3x3 conv = image_conv(320, 96, 16);
    pack3x3(conv, 16, precision);
    add_conv(conv.row_winograd ? "3x3 16 -> 16, 320x96, F(2, 3)" : "3x3 16 -> 16, 320x96, direct",
             conv, precision, conv.channels, product({320, 96, conv.channels}));
  }

  // To so many channels in bytes only: in floats it is Winograd's.
  void conv3x3_in_bytes() {
    kernels::Conv3x3 conv = image_conv(80, 24, 64);
    pack3x3(conv, 64, Precision::kInt8);
    add_conv("3x3 64 -> 64, 80x24, direct", conv, Precision::kInt8, conv.channels,
             product({80, 24, conv.channels}));
  }

  // The paper's last layer before the condition: so few products that its rows count.
  void reflected_conv3x3() {
    kernels::Conv3x3 conv = image_conv(320, 96, 8);
    conv.inputs[0].upsampling = Upsampling::kNearest;
    conv.width = 640;
    conv.height = 192;
    conv.padding = Padding::kReflect;
    pack3x3(conv, 8, Precision::kFloat32);
    add_conv("3x3 8 -> 8, 640x192 nearest, reflected", conv, Precision::kFloat32, conv.channels,
             product({320, 96, conv.channels}));
  }

  void upsampled_conv3x3(Precision precision) {
    kernels::Conv3x3 conv;
    conv.width = 320;
    conv.height = 96;
    conv.input_count = 0;
    conv.weights = pack(0, 16);
    conv.upsampled = {values(product({160, 48, 32})), 48, 160, 32, pack(32, 9 * 16, precision)};
    add_conv("3x3 32 -> 16 of doubled 160x48", conv, precision, 32, product({160, 48, 32}));
  }

  void winograd() {
    const int columns = 64;
    kernels::WinogradConv args;
    args.conv = image_conv(80, 24, 64);
    const std::span<float> panels =
        floats(static_cast<double>(kernels::winograd_floats(args.conv.channels, columns)));
    if (!status_) return;
    kernels::pack_winograd(
        args.conv.channels, columns,
        [](int c, int n, int tap) { return 1e-3F * static_cast<float>(c - n + tap); }, panels);
    args.panels = panels.data();
    args.conv.weights.columns = columns;
    args.conv.weights.bias = values(columns);
    const int pixels = args.conv.height * args.conv.width;
    args.conv.output = values(product({pixels, columns}));
    float* scratch = values(static_cast<double>(kernels::winograd_scratch(args)));
    add({"3x3 64 -> 64, 80x24, Winograd", Precision::kFloat32,
         product({pixels, 9, args.conv.channels, columns}),
         float_bytes(product({pixels, args.conv.channels + columns})),
         [=] { kernels::winograd_rows(args, 0, args.conv.height, scratch); }});
  }

  void layer_norm() {
    const int rows = 4 * 480;
    kernels::LayerNorm norm{values(product({rows, 96})), 96, values(96), values(96), 1e-5F,
                            values(product({rows, 96}))};
    add({"layer norm 1920 x 96", Precision::kFloat32, 0, float_bytes(product({2, rows, 96})),
         [=] { kernels::layer_norm_rows(norm, 0, rows); }});
  }

  void group_norm() {
    kernels::GroupNorm norm;
    norm.height = 192;
    norm.width = 640;
    norm.channels = 16;
    norm.groups = 4;
    norm.epsilon = 1e-5F;
    norm.activation = Activation::kRelu;
    const double count = product({norm.height, norm.width, norm.channels});
    norm.input = values(count);
    norm.weight = values(norm.channels);
    norm.bias = values(norm.channels);
    norm.row_moments = values(product({norm.height, 2, norm.channels}));
    norm.output = values(count);
    add({"group norm 16, 640x192", Precision::kFloat32, 0, float_bytes(3 * count), [=] {
           kernels::group_norm_moments(norm, 0, norm.height);
           kernels::group_norm_apply(norm, 0, norm.height);
         }});
  }

  // The paper's, whose hidden layer a norm needs whole.
  void head_hidden() {
    kernels::HeadStep step;
    step.height = 192;
    step.width = 640;
    step.channels = kHeadChannels;
    step.relu = false;
    const int pixels = step.height * step.width;
    step.shared = values(product({pixels, step.channels}));
    step.state = values(pixels);
    step.scale = values(step.channels);
    step.constant = values(product({kernels::kHeadPlaces, step.channels}));
    step.composed = values(product({kernels::kHeadPlaces, 25, step.channels}));
    step.hidden = values(product({pixels, step.channels}));
    add({"hidden layer of the head, 640x192", Precision::kFloat32,
         product({pixels, step.channels, 25}),
         float_bytes(product({pixels, 2 * step.channels + 1})),
         [=] { kernels::head_hidden_rows(step, 0, step.height); }});
  }

  // The first of two steps that start from zeros has no state to convolve.
  void head(Precision precision, bool has_state) {
    kernels::HeadUpdate update;
    update.precision = precision;
    kernels::HeadStep& step = update.step;
    step.height = 192;
    step.width = 640;
    step.channels = kHeadChannels;
    const int pixels = step.height * step.width;
    step.shared = values(product({pixels, step.channels}));
    update.state = values(pixels);
    if (has_state) step.state = update.state;
    step.scale = values(step.channels);
    step.constant = values(product({kernels::kHeadPlaces, step.channels}));
    const auto composed = floats(product({kernels::kHeadPlaces, 25, step.channels}));
    const auto taps = floats(product({9, step.channels}));
    if (!status_) return;
    step.composed = stored(kernels::pack_composed(composed, step.channels, precision));
    update.weights = stored(kernels::pack_update_weights(taps, step.channels, precision));
    update.p = 1;
    update.q = 0.1F;
    update.next = values(pixels);
    float* scratch = values(static_cast<double>(kernels::head_update_scratch(update)));
    const char* name =
        has_state ? "sampler step of the head, 640x192" : "sampler step from zeros, 640x192";
    add({name, precision, product({pixels, step.channels, (has_state ? 25 : 0) + 9}),
         float_bytes(product({pixels, step.channels + 2})),
         [=] { kernels::head_update_rows(update, 0, update.step.height, scratch); }});
  }

  void depth() {
    const int pixels = 640 * 192;
    const kernels::ToDepth args = {values(pixels), 1, 0, 1, values(pixels)};
    add({"logit to metres, 640x192", Precision::kFloat32, 0, float_bytes(2.0 * pixels),
         [=] { kernels::depth_range(args, 0, pixels); }});
  }

  void patches() {
    const kernels::Patches patches = {24, 80, 96};
    const double count = product({patches.height, patches.width, patches.channels});
    float* image = values(count);
    float* tokens = values(count);
    add({"unfold 96, 80x24", Precision::kFloat32, 0, float_bytes(2 * count),
         [=] { kernels::unfold_rows(patches, image, tokens, 0, patches.height / 2); }});
    add({"fold 96, 80x24", Precision::kFloat32, 0, float_bytes(2 * count),
         [=] { kernels::fold_rows(patches, tokens, image, 0, patches.height / 2); }});
  }

  void resize() {
    kernels::Resize args{nullptr, 15, 20, 16, 20, 144, nullptr};
    const double in = product({15, 20, 144});
    const double out = product({16, 20, 144});
    args.input = values(in);
    args.output = values(out);
    add({"resize 144, 20x15 to 20x16", Precision::kFloat32, 0, float_bytes(in + out),
         [=] { kernels::resize_rows(args, 0, args.out_height); }});
  }

  void camera_formats() {
    preprocess("YUYV 640x480 to 384x288", {PixelFormat::kYuyv, 640, 480, 2 * 640}, 384, 288, {});
    preprocess("NV12 1920x1080 to 448x256", {PixelFormat::kNv12, 1920, 1080, 1920}, 448, 256, {});
    CameraModel lens = CameraModel::from_field_of_view(640, 480, 65);
    lens.distortion = {-0.2F, 0.03F};
    const Result<CameraModel> view = pinhole_view(lens, 384, 288);
    Result<std::vector<CameraBox>> map = view ? make_lens_map(lens, *view) : view.status();
    if (!map) {
      status_ = map.status();
      return;
    }
    preprocess("YUYV 640x480 to 384x288, lens", {PixelFormat::kYuyv, 640, 480, 2 * 640}, 384, 288,
               std::move(*map));
  }

  // A camera's bytes to the network's input.
  void preprocess(const char* name, const FrameFormat& format, int width, int height,
                  std::vector<CameraBox> lens_map) {
    Result<Preprocess> made = Preprocess::prepare(format, width, height, 1, std::move(lens_map));
    if (!made) {
      status_ = made.status();
      return;
    }
    const double count = product({height, width, 3});
    float* input = values(count);
    std::vector<std::uint8_t> picture(picture_bytes(format), 90);
    const double bytes = static_cast<double>(picture.size()) + float_bytes(count);
    add({name, Precision::kFloat32, 0, bytes,
         [=, rows = std::move(*made), picture = std::move(picture)]() mutable {
           rows.run_rows({format, {}, picture.data(), picture.size()}, 0, 0, height, input);
         }});
  }

  void millimetres() {
    const std::span<const float> metres = floats(640 * 192);
    std::vector<std::uint16_t> out(metres.size());
    const auto bytes = static_cast<double>(metres.size() * (sizeof(float) + sizeof(out[0])));
    add({"metres to millimetres, 640x192", Precision::kFloat32, 0, bytes,
         [=, out = std::move(out)]() mutable { depth_to_millimetres(metres, out); }});
  }

  ConstantStore& store_;
  Status status_ = Status::ok();
  std::vector<KernelCase> cases_;
};

}  // namespace

Result<std::vector<KernelCase>> make_kernel_cases(ConstantStore& store) {
  Cases cases(store);
  std::vector<KernelCase> made = cases.make();
  if (!cases.status()) return cases.status();
  return made;
}

}  // namespace lcdm
