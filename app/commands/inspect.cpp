// lcdm inspect model [FILE]: what a model file is, and the network made from it, layer by layer.
#include <cstdio>
#include <memory>
#include <string>

#include "app/commands/commands.h"
#include "app/common_options.h"
#include "app/report.h"
#include "firmware/base/exit_code.h"
#include "firmware/nn/network_plan.h"

namespace lcdm {
namespace {

constexpr CameraModel kWideCamera{1242, 375, 720, 720, 621, 187, false};

void print_model(const ModelFile& file) {
  const ModelConfig& config = file.config();
  std::printf("name     %s\n", config.name.c_str());
  std::printf("licence  %s\n", config.licence.c_str());
  std::printf("network  encoder %s, preset %s, %zu sampling steps, %s scale\n",
              to_string(config.encoder), to_string(config.preset), config.steps.size(),
              to_string(config.scale));
  std::printf("file     %zu bytes, %zu tensors, hash %016llx\n", file.file_bytes(),
              file.tensors().size(), static_cast<unsigned long long>(file.hash()));
  std::printf("card     %s\n\n", config.card.c_str());
}

void print_plan(const Network& network) {
  std::printf("%4s %-44s %-14s %18s %12s %10s %10s %9s  %s\n", "step", "layer", "kind",
              "height x width x c", "MACs", "offset", "bytes", "in use", "last reader");
  std::int64_t macs = 0;
  std::size_t end = 0;
  const std::vector<PlanRow> rows = plan_rows(network);
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const PlanRow& row = rows[i];
    char shape[32];
    std::snprintf(shape, sizeof(shape), "%d x %d x %d", row.shape.height, row.shape.width,
                  row.shape.channels);
    char steps[24];
    std::snprintf(steps, sizeof(steps), "%d-%d", row.first, row.last);
    const bool is_read = row.last > row.first;
    const char* reader = is_read ? rows[static_cast<std::size_t>(row.last)].name.c_str() : "-";
    std::printf("%4zu %-44s %-14s %18s %12lld %10zu %10zu %9s  %s\n", i, row.name.c_str(), row.kind,
                shape, static_cast<long long>(row.macs), row.offset, row.bytes, steps, reader);
    macs += row.macs;
    end = std::max(end, row.offset + row.bytes);
  }
  std::printf("\n%.3f GMAC a frame, %.2f MB for the layers' outputs\n",
              static_cast<double>(macs) * 1e-9, static_cast<double>(end) * 1e-6);
}

int inspect(const CommonOptions& common) {
  const Result<Config> config = common.load();
  if (!config) return report(config.status());
  const Result<ModelFile> file = load_model(*config);
  if (!file) return report(file.status());
  NetworkSize size{config->model.width, config->model.height};
  if (size.width == 0) size = choose_network_size(file->config(), kWideCamera);
  const auto network = Network::build(file->config(), size.width, size.height);
  if (!network) return report(network.status());
  print_model(*file);
  print_plan(*network);
  const Status complete = network->check_weights(*file);
  return complete ? kExitOk : report(complete);
}

}  // namespace

void add_inspect_command(CLI::App& program, int& exit_code) {
  auto common = std::make_shared<CommonOptions>();
  CLI::App* command = program.add_subcommand("inspect", "Look inside a file");
  command->require_subcommand(1);
  CLI::App* model = command->add_subcommand(
      "model", "Name, licence and card; every layer with shape, MACs and place in the arena");
  model->add_option("file", common->model, "The weights (default: the released ones)")
      ->type_name("FILE");
  model
      ->add_option("--set", common->assignments,
                   "model.width and model.height choose the input size (default: 640x192)")
      ->type_name("KEY=VALUE")
      ->allow_extra_args(false);
  model->callback([common, &exit_code] { exit_code = inspect(*common); });
}

}  // namespace lcdm
