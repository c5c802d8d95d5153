#include <cstdio>
#include <optional>

#include "firmware/nn/model_file.h"
#include "model/commands.h"
#include "model/exporter.h"
#include "model/trainer.h"

namespace lcdm::model {
namespace {

struct Options {
  std::string checkpoint;
  std::string output;
  std::string name;
  std::string card;
  std::optional<StartKind> start;
  std::string licence =
      "LicenseRef-research-non-commercial (KITTI CC-BY-NC-SA-3.0; 7-Scenes and CamVid research "
      "only)";
};

Status run(const Options& options) {
  Result<DepthNetwork> network = load_checkpoint(options.checkpoint);
  if (!network) return network.status();
  ModelConfig& config = (*network)->config;
  config.name = options.name;
  config.licence = options.licence;
  config.card = options.card;
  config.start = options.start.value_or(config.start);
  LCDM_RETURN_IF_ERROR(export_network(*network, options.output));
  const Result<ModelFile> check = ModelFile::load(options.output);
  if (!check) return check.status();
  std::printf("%s: %zu tensors, %zu bytes\n", options.output.c_str(), check->tensors().size(),
              check->file_bytes());
  return Status::ok();
}

}  // namespace

void add_export(CLI::App& app, Status& status) {
  auto* command = app.add_subcommand("export", "Writes a checkpoint's weights for the device");
  auto options = std::make_shared<Options>();
  command->add_option("--checkpoint", options->checkpoint, "Training checkpoint")
      ->required()
      ->check(CLI::ExistingFile);
  command->add_option("--output", options->output, "The .safetensors file")->required();
  command->add_option("--name", options->name, "Name in the file")->required();
  command->add_option("--card", options->card, "One paragraph: data, steps, metrics")->required();
  command->add_option("--licence", options->licence, "That follows from the data")
      ->capture_default_str();
  const std::map<std::string, StartKind> starts = {{"noise", StartKind::kNoise},
                                                   {"zeros", StartKind::kZeros}};
  command
      ->add_option_function<StartKind>(
          "--start", [options](const StartKind& start) { options->start = start; },
          "The sampler's start, where another than the training's does better on validation")
      ->transform(CLI::CheckedTransformer(starts));
  command->callback([options, &status] { status = run(*options); });
}

}  // namespace lcdm::model
