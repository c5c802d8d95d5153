// lcdm doctor: is this machine fit to be a camera?
#include "app/doctor.h"

#include <algorithm>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>

#include "app/commands/commands.h"
#include "app/common_options.h"
#include "app/json_text.h"
#include "app/report.h"
#include "firmware/base/exit_code.h"

namespace lcdm {
namespace {

void print_json(const std::vector<Finding>& findings) {
  nlohmann::json json = nlohmann::json::array();
  for (const Finding& finding : findings) {
    json.push_back({{"severity", to_string(finding.severity)},
                    {"subject", finding.subject},
                    {"text", finding.text}});
  }
  std::printf("%s", json_text(json).c_str());
}

int doctor(const CommonOptions& options, bool as_json) {
  const Result<Config> config = options.load();
  if (!config) return report(config.status());
  const std::vector<Finding> findings = examine(*config, "");
  if (as_json) {
    print_json(findings);
  } else {
    for (const Finding& finding : findings) {
      std::printf("%-8s %-9s %s\n", to_string(finding.severity), finding.subject.c_str(),
                  finding.text.c_str());
    }
  }
  const bool faulty = std::any_of(findings.begin(), findings.end(), [](const Finding& finding) {
    return finding.severity == Severity::kFault;
  });
  return faulty ? kExitFailure : kExitOk;
}

}  // namespace

void add_doctor_command(CLI::App& program, int& exit_code) {
  struct Options {
    CommonOptions common;
    bool json = false;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = program.add_subcommand(
      "doctor",
      "Is this machine fit? Each finding one line with its cure; status 1 if depth cannot "
      "come");
  command->add_flag("--json", options->json, "As JSON");
  options->common.add_to(*command);
  options->common.add_model_to(*command);
  command->callback([options, &exit_code] { exit_code = doctor(options->common, options->json); });
}

}  // namespace lcdm
