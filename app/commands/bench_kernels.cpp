#include "app/commands/bench_kernels.h"

#include <algorithm>
#include <cstdio>
#include <functional>
#include <limits>
#include <map>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "app/commands/bench_kernel_cases.h"
#include "firmware/base/os.h"
#include "firmware/nn/kernels/isa.h"
#include "firmware/nn/kernels/matrix.h"
#include "firmware/nn/kernels/peak.h"

namespace lcdm {
namespace {

constexpr int kRounds = 15;  // of everything in turn; the best counts

// What one instruction set did, in the best of all rounds.
struct Measured {
  std::string isa;
  std::vector<KernelCase> cases;
  std::vector<double> ns;  // of each case
  double gmacs = 0;        // multiply-adds in fp32
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
    Result<std::vector<KernelCase>> cases = make_kernel_cases(store);
    if (!cases) return cases.status();
    Measured measured{isa, std::move(*cases), {}, 0};
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
  std::printf("%-39s %-5s", "kernel (ms, limit / time)", "");
  for (const Measured& measured : all) std::printf(" %15s", measured.isa.c_str());
  for (const auto& [key, cells] : rows) {
    std::printf("\n%-39s %-5s", key.first.c_str(), to_string(key.second));
    for (const Measured& measured : all) {
      const auto found = cells.find(measured.isa);
      std::printf(" %15s", found != cells.end() ? found->second.c_str() : "");
    }
  }
  std::printf("\n%-39s %-5s", "limit of multiply-adds, GFLOP/s", "fp32");
  for (const Measured& measured : all) std::printf(" %15.1f", 2 * measured.gmacs);
  std::printf("\n%-39s %-5s %15.1f\n", "limit of copying 8 MB, GB/s", "", bytes_per_ns);
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
