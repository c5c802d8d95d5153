// The program's commands, one file each. Every add_* registers a command with its options; when it
// is the one that was asked for, its callback puts the process's exit status into `exit_code`.
#pragma once

#include <CLI/CLI.hpp>

namespace lcdm {

void add_run_command(CLI::App& program, int& exit_code);
void add_infer_command(CLI::App& program, int& exit_code);
void add_record_command(CLI::App& program, int& exit_code);
void add_calibrate_command(CLI::App& program, int& exit_code);
void add_bench_command(CLI::App& program, int& exit_code);
void add_inspect_command(CLI::App& program, int& exit_code);
void add_check_command(CLI::App& program, int& exit_code);
void add_probe_command(CLI::App& program, int& exit_code);
void add_doctor_command(CLI::App& program, int& exit_code);

}  // namespace lcdm
