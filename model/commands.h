// The subcommands of lcdm-train. Each adds itself to the program; when chosen, it runs while the
// command line is parsed and leaves its outcome in `status`.
#pragma once

#include <CLI/CLI.hpp>

#include "firmware/base/status.h"

namespace lcdm::model {

void add_train(CLI::App& app, Status& status);
void add_teach(CLI::App& app, Status& status);
void add_imitate(CLI::App& app, Status& status);
void add_ablate(CLI::App& app, Status& status);
void add_report(CLI::App& app, Status& status);
void add_evaluate(CLI::App& app, Status& status);
void add_compare(CLI::App& app, Status& status);
void add_export(CLI::App& app, Status& status);
void add_golden(CLI::App& app, Status& status);
void add_pack(CLI::App& app, Status& status);

}  // namespace lcdm::model
