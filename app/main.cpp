// The program lcdm: finds the command that was asked for and runs it.
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <malloc.h>
#include <new>
#include <system_error>

#include "app/commands/commands.h"
#include "app/version.h"
#include "firmware/base/exit_code.h"
#include "firmware/nn/kernels/isa.h"

namespace {

// Whatever fails is said by us, in one line; OpenCV and its FFmpeg would add their own.
void quiet_libraries() {
  setenv("OPENCV_LOG_LEVEL", "OFF", 0);          // NOLINT(concurrency-mt-unsafe): no threads yet
  setenv("OPENCV_FFMPEG_LOGLEVEL", "-8", 0);     // NOLINT(concurrency-mt-unsafe): AV_LOG_QUIET
  setenv("LIBCAMERA_LOG_LEVELS", "*:FATAL", 0);  // NOLINT(concurrency-mt-unsafe)
}

// One heap for all threads, and large blocks given back at once: otherwise each thread that ever
// served somebody keeps what it once needed, and a program that runs for months grows by that.
// Those that must not wait for the heap do not use it.
void keep_heap_small() {
  constexpr int kLargeBlock = 128 << 10;   // glibc's own, which else grows with what is freed
  mallopt(M_ARENA_MAX, 1);                 // NOLINT(concurrency-mt-unsafe): no threads yet
  mallopt(M_MMAP_THRESHOLD, kLargeBlock);  // NOLINT(concurrency-mt-unsafe)
}

}  // namespace

int main(int argc, char** argv) {
  quiet_libraries();
  keep_heap_small();
  if (const lcdm::Status status = lcdm::kernels::force_isa_of_environment(); !status) {
    std::fprintf(stderr, "lcdm: %s\n", status.text());
    return lcdm::kExitUsage;
  }
  try {
    CLI::App program("LCDM-Mono: depth from one camera", "lcdm");
    program.require_subcommand(1);
    program.set_version_flag("--version", std::string("lcdm ") + lcdm::kVersion,
                             "Print the version");
    int exit_code = lcdm::kExitOk;
    lcdm::add_run_command(program, exit_code);
    lcdm::add_infer_command(program, exit_code);
    lcdm::add_record_command(program, exit_code);
    lcdm::add_calibrate_command(program, exit_code);
    lcdm::add_bench_command(program, exit_code);
    lcdm::add_inspect_command(program, exit_code);
    lcdm::add_check_command(program, exit_code);
    lcdm::add_probe_command(program, exit_code);
    lcdm::add_doctor_command(program, exit_code);
    try {
      program.parse(argc, argv);
    } catch (const CLI::ParseError& error) {
      if (error.get_exit_code() == 0) return program.exit(error);  // --help
      std::fprintf(stderr, "lcdm: %s (see lcdm --help)\n", error.what());
      return lcdm::kExitUsage;
    }
    return exit_code;
  } catch (const std::bad_alloc&) {
    std::fprintf(stderr, "lcdm: out of memory: free some, or raise the limit of this process\n");
    return lcdm::kExitFailure;
  } catch (const std::system_error& error) {
    std::fprintf(stderr,
                 "lcdm: %s: raise the limits of this process (threads: ulimit -u, TasksMax=)\n",
                 error.what());
    return lcdm::kExitFailure;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "lcdm: %s\n", error.what());
    return lcdm::kExitFailure;
  }
}
