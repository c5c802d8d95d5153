// lcdm-train: trains the network offline, evaluates it, exports it for the device.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <opencv2/core.hpp>
#include <string>
#include <system_error>
#include <unistd.h>

#include "firmware/base/exit_code.h"
#include "firmware/nn/kernels/isa.h"
#include "model/commands.h"
#include "model/torch.h"

namespace {

// Libraries read these when they are loaded, before main: the program starts itself again with
// them. Spinning threads collapse on a busy machine, OpenBLAS's threads fight OpenMP's, and it
// takes its slowest kernels on processors it does not know.
void restart_with_environment(char** argv) {
  constexpr const char* kMark = "LCDM_TRAIN_ENVIRONMENT";
  if (std::getenv(kMark) != nullptr) return;
  setenv(kMark, "set", 1);
  setenv("OPENBLAS_NUM_THREADS", "1", 0);
  setenv("GOMP_SPINCOUNT", "0", 0);
  // Freed tensors stay with the program: asking the kernel for them anew is an eighth of a step.
  setenv("MALLOC_ARENA_MAX", "1", 0);
  setenv("MALLOC_MMAP_THRESHOLD_", "4000000000", 0);
  setenv("MALLOC_TRIM_THRESHOLD_", "16000000000", 0);
  setenv("MALLOC_TOP_PAD_", "64000000", 0);
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl")) {
    setenv("OPENBLAS_CORETYPE", "SKYLAKEX", 0);
    setenv("ATEN_CPU_CAPABILITY", "avx512", 0);  // LibTorch takes AVX2's kernels unless it is told
  } else if (__builtin_cpu_supports("avx2")) {
    setenv("OPENBLAS_CORETYPE", "HASWELL", 0);
  }
#endif
  // oneDNN 2.6's AMX convolutions make bf16 gradients that are not finite.
  setenv("ONEDNN_MAX_CPU_ISA", "AVX512_CORE_BF16", 0);
  // With its newer interface cuDNN 9 compiles kernels for every layer and size, for minutes, before
  // the first step (LibTorch 2.11 on an H200).
  setenv("TORCH_CUDNN_V8_API_DISABLED", "1", 0);
  std::error_code error;
  const std::string program = std::filesystem::read_symlink("/proc/self/exe", error).string();
  if (!error) execv(program.c_str(), argv);  // by its own name, for ps and pkill
}

// A recipe of another command would be left out without a word.
void require_section(const CLI::App& app, const std::string& recipe) {
  if (recipe.empty()) return;
  const std::string command = app.get_subcommands().front()->get_name();
  for (const CLI::ConfigItem& item : CLI::ConfigTOML().from_file(recipe)) {
    if (!item.parents.empty() && item.parents.front() == command) return;
  }
  throw CLI::ConfigError(recipe + ": nothing in it is for '" + command +
                             "': its options stand under [" + command + "]",
                         CLI::ExitCodes::ConfigError);
}

}  // namespace

int main(int argc, char** argv) {
  restart_with_environment(argv);
  if (const lcdm::Status status = lcdm::kernels::force_isa_of_environment(); !status) {
    std::fprintf(stderr, "lcdm-train: %s\n", status.text());
    return lcdm::kExitUsage;
  }
  CLI::App app("Trains, evaluates and exports LCDM-Mono networks");
  app.require_subcommand(1);
  int threads = 2;
  app.add_option("--threads", threads, "CPU threads of a LibTorch operator")
      ->check(CLI::Range(1, 256))
      ->capture_default_str();
  lcdm::Status status;
  const CLI::Option* recipe = app.set_config(
      "--recipe", "", "File of options, those of a command under its name (model/recipes/)");
  app.allow_config_extras(CLI::config_extras_mode::error);
  app.parse_complete_callback([&] {
    require_section(app, recipe->empty() ? "" : recipe->as<std::string>());
    at::set_num_threads(threads);
    cv::setNumThreads(1);
  });
  lcdm::model::add_train(app, status);
  lcdm::model::add_teach(app, status);
  lcdm::model::add_imitate(app, status);
  lcdm::model::add_ablate(app, status);
  lcdm::model::add_evaluate(app, status);
  lcdm::model::add_report(app, status);
  lcdm::model::add_export(app, status);
  lcdm::model::add_compare(app, status);
  lcdm::model::add_golden(app, status);
  lcdm::model::add_pack(app, status);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) return app.exit(error);  // --help
    std::fprintf(stderr, "lcdm-train: %s (see lcdm-train --help)\n", error.what());
    return lcdm::kExitUsage;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "lcdm-train: %s\n", error.what());
    return lcdm::kExitFailure;
  }
  if (!status) std::fprintf(stderr, "lcdm-train: %s\n", status.text());
  return lcdm::exit_code_of(status);
}
