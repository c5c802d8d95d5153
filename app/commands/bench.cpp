// lcdm bench: how fast the engine is on this machine, and what it takes.
#include <algorithm>
#include <cctype>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "app/commands/bench_kernels.h"
#include "app/commands/bench_profile.h"
#include "app/commands/commands.h"
#include "app/common_options.h"
#include "app/json_text.h"
#include "app/report.h"
#include "firmware/base/alloc_watch.h"
#include "firmware/base/exit_code.h"
#include "firmware/base/os.h"
#include "firmware/nn/kernels/isa.h"
#include "firmware/nn/network.h"

namespace lcdm {
namespace {

constexpr int kWarmUpFrames = 3;
constexpr int kFewestFrames = 20;
constexpr int kMostFrames = 1000;
constexpr std::int64_t kShortestRunNs = 5'000'000'000;

struct BenchOptions {
  CommonOptions common;
  int threads = 0;
  std::string size;
  std::string source_format;
  bool json = false;
  bool profile = false;
  bool kernels = false;
};

struct BenchResult {
  std::vector<double> milliseconds;  // sorted
  double allocations_per_frame = 0;
  double faults_per_frame = 0;  // page faults of all threads
  double prepare_ms = 0;
  EngineStats stats;
  std::unique_ptr<Engine> engine;
  EngineProfile profile;

  double percentile(int p) const {
    return milliseconds[(milliseconds.size() - 1) * static_cast<std::size_t>(p) / 100];
  }
  double mean() const {
    double sum = 0;
    for (const double each : milliseconds) sum += each;
    return sum / static_cast<double>(milliseconds.size());
  }
};

// Smooth shapes and some noise, so that no value is special. [height, width, 3]
std::vector<std::uint8_t> make_picture(int width, int height) {
  std::vector<std::uint8_t> pixels;
  pixels.reserve(static_cast<std::size_t>(width) * static_cast<std::size_t>(height) * 3);
  std::uint32_t noise = 1;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      noise = noise * 1664525U + 1013904223U;
      const int shade = (x * 3 + y * 5 + (x * y) / 97) & 0xFF;
      for (int channel = 0; channel < 3; ++channel) {
        pixels.push_back(static_cast<std::uint8_t>(
            std::min(255, (shade * (channel + 2)) / 4 + static_cast<int>(noise >> 28))));
      }
    }
  }
  return pixels;
}

// Frames of that format through the whole engine, preprocessing included.
Result<BenchResult> measure(const ModelFile& model, const EngineOptions& options,
                            const FrameFormat& format) {
  const CameraModel camera = CameraModel::from_field_of_view(format.width, format.height, 65);
  const std::int64_t asked = os::monotonic_ns();
  auto engine = Engine::prepare(model, options, format, camera);
  if (!engine) return engine.status();

  BenchResult result;
  result.prepare_ms = static_cast<double>(os::monotonic_ns() - asked) * 1e-6;
  // No other format has more bytes; what they show in it does not matter.
  const std::vector<std::uint8_t> pixels = make_picture(format.width, format.height);
  const FrameView frame{format, {}, pixels.data(), pixels.size()};
  std::vector<std::uint16_t> depth(static_cast<std::size_t>(options.width) *
                                   static_cast<std::size_t>(options.height));
  const DepthBuffer out{options.width, options.height, depth.data(), nullptr};
  result.milliseconds.reserve(kMostFrames);
  for (int i = 0; i < kWarmUpFrames; ++i) LCDM_RETURN_IF_ERROR((*engine)->run(frame, out));
  result.profile.layer_ns.resize((*engine)->network().layers().size());

  const std::uint64_t allocations = alloc_watch::process_allocations();
  const std::int64_t faults = os::page_faults();
  const std::int64_t begin = os::monotonic_ns();
  for (int i = 0; i < kMostFrames; ++i) {
    const std::int64_t before = os::monotonic_ns();
    LCDM_RETURN_IF_ERROR((*engine)->run_timed(frame, out, result.profile));
    const std::int64_t after = os::monotonic_ns();
    result.milliseconds.push_back(static_cast<double>(after - before) * 1e-6);
    if (i + 1 >= kFewestFrames && after - begin >= kShortestRunNs) break;
  }
  result.allocations_per_frame =
      static_cast<double>(alloc_watch::process_allocations() - allocations) /
      static_cast<double>(result.milliseconds.size());
  result.faults_per_frame = static_cast<double>(os::page_faults() - faults) /
                            static_cast<double>(result.milliseconds.size());
  std::sort(result.milliseconds.begin(), result.milliseconds.end());
  result.stats = (*engine)->stats();
  result.engine = std::move(*engine);
  return result;
}

void print_json(const BenchResult& result) {
  const EngineStats& stats = result.stats;
  const nlohmann::json json = {
      {"model", stats.model_name},
      {"width", stats.width},
      {"height", stats.height},
      {"threads", stats.threads},
      {"isa", kernels::isa_name()},
      {"precision", to_string(stats.precision)},
      {"prepare_ms", result.prepare_ms},
      {"frames", result.milliseconds.size()},
      {"latency_ms",
       {{"p50", result.percentile(50)},
        {"p95", result.percentile(95)},
        {"p99", result.percentile(99)}}},
      {"frames_per_second", 1000 / result.mean()},
      {"macs", stats.macs},
      {"arena_bytes", stats.arena_bytes},
      {"weight_bytes", stats.weight_bytes},
      {"preprocess_bytes", stats.preprocess_bytes},
      {"peak_rss_bytes", os::peak_rss_bytes()},
      {"allocations_per_frame", result.allocations_per_frame},
      {"page_faults_per_frame", result.faults_per_frame},
      {"memory_locked", stats.memory_locked},
      {"huge_pages", os::gives_huge_pages()},
  };
  std::printf("%s", json_text(json).c_str());
}

void print_text(const BenchResult& result) {
  const EngineStats& stats = result.stats;
  std::printf("model      %s\n", stats.model_name.c_str());
  std::printf("input      %dx%d, %.3f GMAC\n", stats.width, stats.height,
              static_cast<double>(stats.macs) * 1e-9);
  std::printf("threads    %d, kernels for %s\n", stats.threads, kernels::isa_name());
  std::printf("precision  %s\n", to_string(stats.precision));
  std::printf("prepared   in %.0f ms\n", result.prepare_ms);
  std::printf("latency    p50 %.1f ms, p95 %.1f ms, p99 %.1f ms over %zu frames\n",
              result.percentile(50), result.percentile(95), result.percentile(99),
              result.milliseconds.size());
  std::printf("rate       %.1f frames a second\n", 1000 / result.mean());
  std::printf("arena      %.2f MB\n", static_cast<double>(stats.arena_bytes) * 1e-6);
  std::printf("weights    %.2f MB\n", static_cast<double>(stats.weight_bytes) * 1e-6);
  std::printf("preprocess %.2f MB\n", static_cast<double>(stats.preprocess_bytes) * 1e-6);
  std::printf("peak RSS   %.1f MB\n", static_cast<double>(os::peak_rss_bytes()) * 1e-6);
  std::printf("heap       %g allocations a frame\n", result.allocations_per_frame);
  std::printf("faults     %g page faults a frame; arena and weights %slocked against swapping\n",
              result.faults_per_frame, stats.memory_locked ? "" : "not ");
  std::printf("huge pages %s\n", os::gives_huge_pages() ? "given" : "refused by the kernel");
}

Status parse_size(const std::string& text, EngineOptions& options) {
  char rest = 0;
  if (std::sscanf(text.c_str(), "%5dx%5d%c", &options.width, &options.height, &rest) == 2 &&
      Network::is_side(options.width) && Network::is_side(options.height)) {
    return Status::ok();
  }
  return Status::error(StatusCode::kUsage,
                       "--size %s: write it as WIDTHxHEIGHT, as 640x192, of multiples of %d from "
                       "%d to %d",
                       text.c_str(), Network::kSizeStep, Network::kMinSide, Network::kMaxSide);
}

Status parse_source_format(const std::string& text, FrameFormat& format) {
  const std::size_t colon = std::min(text.find(':'), text.size());
  std::string name = text.substr(0, colon);
  for (char& c : name) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  const auto pixel = parse_pixel_format(name);
  char rest = 0;
  if (pixel &&
      std::sscanf(text.c_str() + colon, ":%5dx%5d%c", &format.width, &format.height, &rest) == 2) {
    format.pixel = *pixel;
    format.stride = packed_stride(*pixel, format.width);
    if (is_picture(format)) return Status::ok();
  }
  return Status::error(StatusCode::kUsage,
                       "--source-format %.40s: write it as FORMAT:WIDTHxHEIGHT, as yuyv:640x480; "
                       "there are rgb24, bgr24, yuyv, uyvy, nv12, nv21 and grey, those of YUV with "
                       "even sides",
                       text.c_str());
}

int bench_kernels() {
  const Status status = print_kernel_bench();
  return status ? kExitOk : report(status);
}

int bench(const BenchOptions& given) {
  if (given.kernels) return bench_kernels();
  const std::string threads = given.threads > 0 ? std::to_string(given.threads) : "";
  const Result<Config> config =
      given.common.load(Overrides().add("model.threads", "--threads", threads).take());
  if (!config) return report(config.status());
  EngineOptions options = engine_options(*config);
  if (!given.size.empty()) {
    if (const Status status = parse_size(given.size, options); !status) return report(status);
  } else if (options.width == 0) {
    options.width = 640;
    options.height = 192;
  }
  FrameFormat format{PixelFormat::kRgb24, options.width, options.height, options.width * 3};
  if (!given.source_format.empty()) {
    const Status status = parse_source_format(given.source_format, format);
    if (!status) return report(status);
  }
  const Result<ModelFile> model = load_model(*config);
  if (!model) return report(model.status());
  const Result<BenchResult> result = measure(*model, options, format);
  if (!result) return report(result.status());
  given.json ? print_json(*result) : print_text(*result);
  if (given.profile) {
    print_profile(*result->engine, result->profile, static_cast<int>(result->milliseconds.size()));
  }
  return kExitOk;
}

}  // namespace

void add_bench_command(CLI::App& program, int& exit_code) {
  auto options = std::make_shared<BenchOptions>();
  CLI::App* command =
      program.add_subcommand("bench", "Latency, rate and memory of the engine on this machine");
  command
      ->add_option("--threads", options->threads,
                   "Threads of the engine (default: model.threads of the configuration)")
      ->check(CLI::Range(1, EngineOptions::kMaxThreads));
  command->add_option("--size", options->size, "Network input, multiples of 32 (default: 640x192)")
      ->type_name("WxH");
  command
      ->add_option("--source-format", options->source_format,
                   "Frames to read, as yuyv:640x480 (default: RGB24 of the network's size)")
      ->type_name("FORMAT:WxH");
  auto* json = command->add_flag("--json", options->json, "Print JSON");
  auto* profile =
      command
          ->add_flag("--profile", options->profile,
                     "Print where the time goes: layer by layer, beside the processor's limit")
          ->excludes(json);
  command
      ->add_flag("--kernels", options->kernels,
                 "Instead time each kernel with each instruction set, beside the machine's limits")
      ->excludes(json)
      ->excludes(profile);
  options->common.add_to(*command);
  options->common.add_model_to(*command);
  command->callback([options, &exit_code] { exit_code = bench(*options); });
}

}  // namespace lcdm
