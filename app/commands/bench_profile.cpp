#include "app/commands/bench_profile.h"

#include <cstdio>
#include <map>
#include <numeric>
#include <string>
#include <vector>

#include "firmware/nn/kernels/matrix.h"
#include "firmware/nn/kernels/peak.h"

namespace lcdm {
namespace {

constexpr double kSmallShare = 0.01;  // layers below it are summed up

struct Part {
  std::string name;
  const char* kind = "";  // of a layer; empty: no layer
  double ms = 0;
  double macs = 0;
  int layers = 0;  // of a sum
};

void print_part(const Part& part, double all_ms, double peak) {
  const double rate = part.ms > 0 ? part.macs / (part.ms * 1e6) : 0;
  std::printf("%-42s %-10s %8.3f %6.1f%%", part.name.c_str(), part.kind, part.ms,
              100 * part.ms / all_ms);
  if (part.macs > 0) {
    std::printf(" %9.1f %6.0f%%\n", 2 * rate, 100 * rate / peak);
  } else {
    std::printf(" %9s %7s\n", "-", "-");
  }
}

}  // namespace

void print_profile(const Engine& engine, const EngineProfile& profile, int frames) {
  const auto milliseconds = [frames](std::int64_t ns) {
    return static_cast<double>(ns) * 1e-6 / frames;
  };
  std::vector<Part> parts = {{"preprocess", "", milliseconds(profile.preprocess_ns)}};
  const std::vector<Layer>& layers = engine.network().layers();
  double inside = 0;  // multiply-adds of layers that are computed inside the next stored one
  for (std::size_t i = 0; i < layers.size(); ++i) {
    const auto macs = static_cast<double>(layers[i].macs);
    inside += macs;
    if (!layers[i].stored) continue;
    parts.push_back(
        {layers[i].name, to_string(layers[i].kind), milliseconds(profile.layer_ns[i]), inside});
    inside = 0;
  }
  parts.push_back({"to millimetres", "", milliseconds(profile.output_ns)});

  const double all_ms = std::accumulate(parts.begin(), parts.end(), 0.0,
                                        [](double sum, const Part& part) { return sum + part.ms; });
  const EngineStats stats = engine.stats();
  const double peak =
      kernels::peak_gmacs() * stats.threads * kernels::numbers_per_word(stats.precision);
  std::printf("\n%-42s %-10s %8s %7s %9s %7s\n", "part", "kind", "ms", "share", "GFLOP/s", "limit");
  std::map<std::string, Part> rest;  // by kind
  Part all{"frame", "", 0, 0};
  for (const Part& part : parts) {
    all.ms += part.ms;
    all.macs += part.macs;
    if (part.ms >= kSmallShare * all_ms || *part.kind == '\0') {
      print_part(part, all_ms, peak);
    } else {
      Part& alike = rest[part.kind];
      alike.name = "(" + std::to_string(++alike.layers) + " smaller ones)";
      alike.kind = part.kind;
      alike.ms += part.ms;
      alike.macs += part.macs;
    }
  }
  for (const auto& [kind, part] : rest) print_part(part, all_ms, peak);
  print_part(all, all_ms, peak);
  std::printf("limit      %.0f GFLOP/s: %d thread(s) of independent vector multiply-adds in %s\n",
              2 * peak, stats.threads, to_string(stats.precision));
  std::printf(
      "-          moves and scales numbers: no multiply-adds are counted\n"
      "           a layer may be beyond the limit: the plain sums' multiply-adds are counted,\n"
      "           and exact identities leave fewer\n");
  if (stats.precision == Precision::kFloat32) return;
  std::printf("           what stays in floats can reach 1/%d of the limit\n",
              kernels::numbers_per_word(stats.precision));
}

}  // namespace lcdm
