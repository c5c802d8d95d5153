#include "app/commands/bench_kernels.h"

#include <algorithm>
#include <cstdio>
#include <functional>
#include <limits>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "firmware/base/os.h"
#include "firmware/nn/constant_store.h"
#include "firmware/nn/kernels/attention.h"
#include "firmware/nn/kernels/conv.h"
#include "firmware/nn/kernels/head.h"
#include "firmware/nn/kernels/inverted_residual.h"
#include "firmware/nn/kernels/isa.h"
#include "firmware/nn/kernels/matrix.h"
#include "firmware/nn/kernels/norm.h"
#include "firmware/nn/kernels/peak.h"
#include "firmware/nn/kernels/reshape.h"
#include "firmware/nn/kernels/row_winograd.h"
#include "firmware/nn/kernels/winograd.h"

namespace lcdm {
namespace {

using kernels::PackedMatrix;
using kernels::RowInput;

constexpr int kRounds = 15;  // of everything in turn; the best counts

struct KernelCase {
  std::string name;
  Precision precision = Precision::kFloat32;
  double macs = 0;   // of the plain sums, whatever the algorithm
  double bytes = 0;  // of what is read and written, once each
  std::function<void()> run;
};

// What one instruction set did, in the best of all rounds.
struct Measured {
  std::string isa;
  std::vector<KernelCase> cases;
  std::vector<double> ns;  // of each case
  double gmacs = 0;        // multiply-adds in fp32
};

double product(std::initializer_list<int> factors) {
  double all = 1;
  for (const int factor : factors) all *= factor;
  return all;
}
double float_bytes(double count) { return count * sizeof(float); }

// The cases of the instruction set in use, which packs weights its own way. All memory is
// `store`'s; where it gives none, status() says so and the cases must not be run.
class Cases {
 public:
  explicit Cases(ConstantStore& store) : store_(store) {}

  const Status& status() const { return status_; }

  std::vector<KernelCase> make() {
    for (const Precision precision : kPrecisions) {
      if (kernels::native_precision(precision) != precision) continue;
      matrix(precision);
      inverted_residual(precision);
      conv3x3(precision);
      upsampled_conv3x3(precision);
      if (precision != Precision::kInt8) attention(precision);
      if (kernels::head_precision(precision, kHeadChannels) == precision) {
        head(precision, true);
        head(precision, false);
      }
    }
    stem();
    winograd();
    layer_norm();
    group_norm();
    depth();
    unfold();
    resize();
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

  void inverted_residual(Precision precision) {
    kernels::InvertedResidual block;
    block.height = 48;
    block.width = 160;
    block.channels = 48;
    block.hidden = 192;
    const int pixels = block.height * block.width;
    block.input = values(product({pixels, block.channels}));
    block.expand = pack(block.channels, block.hidden, precision);
    if (precision != Precision::kFloat32 &&
        kernels::native_precision(Precision::kBfloat16) == Precision::kBfloat16) {
      block.filter = Precision::kBfloat16;
    }
    const std::span<float> taps = floats(product({9, block.hidden}));
    block.taps = stored(kernels::pack_filter_taps(taps, block.filter));
    block.taps_bias = values(block.hidden);
    block.project = pack(block.hidden, block.channels, precision);
    block.output = values(product({pixels, block.channels}));
    float* scratch = values(static_cast<double>(kernels::inverted_residual_scratch(block)));
    add({"inverted residual 48-192-48, 160x48", precision,
         product({pixels, block.hidden, 2 * block.channels + 9}),
         float_bytes(product({pixels, 2 * block.channels})),
         [=] { kernels::inverted_residual_rows(block, 0, block.height, scratch); }});
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

  void conv3x3(Precision precision) {
    kernels::Conv3x3 conv = image_conv(320, 96, 16);
    const int columns = 16;
    conv.row_winograd = kernels::row_winograd_pays(1, conv.channels, columns, precision);
    const int depth =
        conv.row_winograd ? kernels::row_winograd_depth(conv.channels) : 9 * conv.channels;
    conv.weights = pack(depth, columns, precision, 3);
    add_conv(conv.row_winograd ? "3x3 16 -> 16, 320x96, F(2, 3)" : "3x3 16 -> 16, 320x96, direct",
             conv, precision, conv.channels, product({320, 96, conv.channels}));
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

  void unfold() {
    const kernels::Patches patches = {24, 80, 96};
    const double count = product({patches.height, patches.width, patches.channels});
    const float* image = values(count);
    float* tokens = values(count);
    add({"unfold 96, 80x24", Precision::kFloat32, 0, float_bytes(2 * count),
         [=] { kernels::unfold_rows(patches, image, tokens, 0, patches.height / 2); }});
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

  ConstantStore& store_;
  Status status_ = Status::ok();
  std::vector<KernelCase> cases_;
};

// CPU time, so that other programs count little.
double nanoseconds_of(const std::function<void()>& run) {
  const std::int64_t begin = os::thread_cpu_ns();
  run();
  return static_cast<double>(os::thread_cpu_ns() - begin);
}

Result<std::vector<Measured>> make_cases(ConstantStore& store) {
  std::vector<Measured> all;
  for (const std::string& isa : kernels::isa_names()) {
    LCDM_RETURN_IF_ERROR(kernels::force_isa(isa));
    Cases cases(store);
    Measured measured{isa, cases.make(), {}, 0};
    if (!cases.status()) return cases.status();
    measured.ns.assign(measured.cases.size(), std::numeric_limits<double>::infinity());
    all.push_back(std::move(measured));
  }
  return all;
}

// Everything in turn, limits too, so that what else the machine does falls on all alike. Returns
// the bytes a nanosecond that a copy moves.
Result<double> measure(std::vector<Measured>& all, std::span<float> memory) {
  double bytes = 0;
  for (int round = 0; round < kRounds; ++round) {
    for (Measured& measured : all) {
      LCDM_RETURN_IF_ERROR(kernels::force_isa(measured.isa));
      measured.gmacs = std::max(measured.gmacs, kernels::peak_gmacs(1));
      for (std::size_t i = 0; i < measured.cases.size(); ++i) {
        measured.ns[i] = std::min(measured.ns[i], nanoseconds_of(measured.cases[i].run));
      }
    }
    bytes = std::max(bytes, kernels::peak_copy(memory));
  }
  return bytes;
}

// ns that the case's arithmetic or traffic would take alone.
double limit_ns(const KernelCase& each, const Measured& measured, double bytes_per_ns) {
  const double rate = measured.gmacs * kernels::numbers_per_word(each.precision);
  return std::max(each.macs / rate, each.bytes / bytes_per_ns);
}

void print_table(const std::vector<Measured>& all, double bytes_per_ns) {
  std::map<std::pair<std::string, Precision>, std::map<std::string, std::string>> rows;
  for (const Measured& measured : all) {
    for (std::size_t i = 0; i < measured.cases.size(); ++i) {
      const KernelCase& each = measured.cases[i];
      char cell[32];
      std::snprintf(cell, sizeof(cell), "%9.3f %5.0f%%", measured.ns[i] * 1e-6,
                    100 * limit_ns(each, measured, bytes_per_ns) / measured.ns[i]);
      rows[{each.name, each.precision}][measured.isa] = cell;
    }
  }
  std::printf("%-38s %-5s", "kernel (ms, limit / time)", "");
  for (const Measured& measured : all) std::printf(" %15s", measured.isa.c_str());
  for (const auto& [key, cells] : rows) {
    std::printf("\n%-38s %-5s", key.first.c_str(), to_string(key.second));
    for (const Measured& measured : all) {
      const auto found = cells.find(measured.isa);
      std::printf(" %15s", found != cells.end() ? found->second.c_str() : "");
    }
  }
  std::printf("\n%-38s %-5s", "limit of multiply-adds, GFLOP/s", "fp32");
  for (const Measured& measured : all) std::printf(" %15.1f", 2 * measured.gmacs);
  std::printf("\n%-38s %-5s %15.1f\n", "limit of copying 8 MB, GB/s", "", bytes_per_ns);
}

}  // namespace

Status print_kernel_bench() {
  constexpr std::size_t kCopied = 4U << 20;  // floats: 8 MB to 8 MB, as the larger layers
  ConstantStore store;
  Result<std::vector<Measured>> all = make_cases(store);
  if (!all) return all.status();
  const Result<std::span<float>> memory = store.add(kCopied);
  if (!memory) return memory.status();
  const Result<double> bytes_per_ns = measure(*all, *memory);
  if (!bytes_per_ns) return bytes_per_ns.status();
  print_table(*all, *bytes_per_ns);
  return Status::ok();
}

}  // namespace lcdm
