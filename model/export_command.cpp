#include <cstdio>
#include <optional>

#include "firmware/nn/model_file.h"
#include "model/checkpoint.h"
#include "model/choice_option.h"
#include "model/commands.h"
#include "model/exporter.h"
#include "model/onnx_export.h"

namespace lcdm::model {
namespace {

struct Options {
  std::vector<std::string> checkpoints;
  std::string model;
  std::string output;
  std::string onnx;
  int width = 640;
  int height = 192;
  std::string name;
  std::string card;
  std::optional<StartKind> start;
  std::string licence;  // instead of the checkpoint's
};

// The checkpoints' weights, or their mean, as the device's model file.
Status write_model(const Options& options) {
  std::vector<DepthNetwork> networks;
  for (const std::string& path : options.checkpoints) {
    Result<DepthNetwork> network = load_checkpoint(path);
    if (!network) return network.status();
    networks.push_back(*network);
  }
  ModelConfig& config = networks[0]->config;
  for (std::size_t i = 1; i < networks.size() && options.licence.empty(); ++i) {
    if (networks[i]->config.licence == config.licence) continue;
    return Status::error(StatusCode::kUsage,
                         "the mean's licence follows from both \"%s\" (%s) and \"%s\" (%s): say "
                         "with --licence what holds for it",
                         config.licence.c_str(), options.checkpoints[0].c_str(),
                         networks[i]->config.licence.c_str(), options.checkpoints[i].c_str());
  }
  config.name = options.name;
  if (!options.licence.empty()) config.licence = options.licence;
  if (config.licence.empty()) {
    return Status::error(StatusCode::kUsage,
                         "the checkpoint does not say what its data asks of the weights: give "
                         "--licence");
  }
  config.card = options.card;
  config.start = options.start.value_or(config.start);
  LCDM_RETURN_IF_ERROR(export_mean(networks, options.output));
  const Result<ModelFile> check = ModelFile::load(options.output);
  if (!check) return check.status();
  std::printf("%s: %zu tensors, %zu bytes\n", options.output.c_str(), check->tensors().size(),
              check->file_bytes());
  return Status::ok();
}

Status run(const Options& options) {
  if (!options.checkpoints.empty()) {
    if (options.output.empty() || options.name.empty() || options.card.empty()) {
      return Status::error(StatusCode::kUsage,
                           "a checkpoint becomes a model file with --output, --name and --card");
    }
    LCDM_RETURN_IF_ERROR(write_model(options));
  } else if (options.model.empty() || options.onnx.empty()) {
    return Status::error(StatusCode::kUsage,
                         "nothing to export: give --checkpoint, or --model with --onnx");
  }
  if (options.onnx.empty()) return Status::ok();
  const Result<ModelFile> file =
      ModelFile::load(options.model.empty() ? options.output : options.model);
  if (!file) return file.status();
  return export_onnx(*file, options.width, options.height, options.onnx);
}

// What a checkpoint becomes; a model file has all of it.
void add_model_options(CLI::App& command, CLI::Option* checkpoint, Options& options) {
  command.add_option("--output", options.output, "The .safetensors file to write")
      ->needs(checkpoint);
  command.add_option("--name", options.name, "Name in the file")->needs(checkpoint);
  command.add_option("--card", options.card, "One paragraph: data, steps, metrics")
      ->needs(checkpoint);
  command
      .add_option("--licence", options.licence,
                  "That follows from the data, instead of the catalogue's it was trained on; "
                  "needed where several checkpoints differ in it")
      ->needs(checkpoint);
  const std::map<std::string, StartKind> starts = {{"noise", StartKind::kNoise},
                                                   {"zeros", StartKind::kZeros}};
  add_choice(command, "--start", options.start, starts,
             "The sampler's start, where another than the training's does better on validation")
      ->needs(checkpoint);
}

}  // namespace

void add_export(CLI::App& app, Status& status) {
  auto* command = app.add_subcommand(
      "export", "Writes a checkpoint's weights for the device, or a model file as ONNX");
  auto options = std::make_shared<Options>();
  auto* checkpoint = command
                         ->add_option("--checkpoint", options->checkpoints,
                                      "Training checkpoint; of several the mean")
                         ->check(CLI::ExistingFile);
  command->add_option("--model", options->model, "Model file, where there is no checkpoint")
      ->check(CLI::ExistingFile)
      ->excludes(checkpoint);
  add_model_options(*command, checkpoint, *options);
  auto* onnx =
      command->add_option("--onnx", options->onnx, "ONNX file to write, for other runtimes");
  command->add_option("--width", options->width, "Of the ONNX graph's input")
      ->needs(onnx)
      ->capture_default_str();
  command->add_option("--height", options->height, "Of the ONNX graph's input")
      ->needs(onnx)
      ->capture_default_str();
  command->callback([options, &status] { status = run(*options); });
}

}  // namespace lcdm::model
