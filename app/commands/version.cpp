#include "app/version.h"

#include <cstdio>

#include "app/commands/commands.h"
#include "firmware/base/exit_code.h"

namespace lcdm {

void add_version_command(CLI::App& program, int& exit_code) {
  CLI::App* command = program.add_subcommand("version", "Print the version");
  command->callback([&exit_code] {
    std::printf("lcdm %s\n", kVersion);
    exit_code = kExitOk;
  });
}

}  // namespace lcdm
