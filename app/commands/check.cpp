// lcdm check [FILE]: is a configuration valid?
#include <cstdio>
#include <memory>

#include "app/commands/commands.h"
#include "app/config.h"
#include "app/report.h"
#include "firmware/base/exit_code.h"

namespace lcdm {
namespace {

int check(std::string file) {
  if (file.empty()) file = default_config_file();
  if (const auto config = load_config({file, process_environment(), {}}); !config) {
    return report(config.status());
  }
  std::printf("%s: valid\n", file.empty() ? "built-in defaults" : file.c_str());
  return kExitOk;
}

}  // namespace

void add_check_command(CLI::App& program, int& exit_code) {
  auto file = std::make_shared<std::string>();
  CLI::App* command = program.add_subcommand(
      "check", "Is a configuration file valid? Says line and column of what is not");
  command->add_option("file", *file, "The file (default: /etc/lcdm/lcdm.toml)");
  command->callback([file, &exit_code] { exit_code = check(*file); });
}

}  // namespace lcdm
