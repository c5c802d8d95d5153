#include <cstdio>
#include <filesystem>
#include <opencv2/imgcodecs.hpp>

#include "firmware/base/file.h"
#include "model/checkpoint.h"
#include "model/choice_option.h"
#include "model/commands.h"
#include "model/data_sets.h"
#include "model/evaluation.h"
#include "model/safetensors.h"
#include "model/torchscript_teacher.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;

constexpr double kUnitsPerMetre = 256;

struct Options {
  std::string pack;
  std::string output;
  std::string model;
  std::string checkpoint;
  TorchscriptOptions torchscript;
  std::vector<int> size = {640, 192};
};

Status write_map(const fs::path& path, const cv::Mat& metres) {
  cv::Mat stored;
  metres.convertTo(stored, CV_16U, kUnitsPerMetre);  // saturates at 255 m
  std::vector<unsigned char> png;
  if (!cv::imencode(".png", stored, png)) {
    return Status::error(StatusCode::kInvalidInput, "%s: no picture to write", path.c_str());
  }
  std::error_code error;
  fs::create_directories(path.parent_path(), error);
  return write_file(path.string(), std::as_bytes(std::span(png)));
}

struct TeachingNetwork {
  Estimator estimator;
  std::string licence;  // empty: of a module nothing is known
};

Result<Estimator> module_of(const Options& options) {
  TorchscriptOptions torchscript = options.torchscript;
  torchscript.input = {options.size[0], options.size[1]};
  const Result<Estimator> module = torchscript_estimator(torchscript);
  if (!module || torchscript.gives != TorchscriptOptions::Gives::kInverse) return module;
  return Estimator(
      [estimate = *module](const PackFrame& frame) { return at_ten_metres(estimate(frame)); });
}

Result<TeachingNetwork> teacher_of(const Options& options) {
  if (!options.torchscript.file.empty()) {
    const Result<Estimator> module = module_of(options);
    if (!module) return module.status();
    return TeachingNetwork{*module, ""};
  }
  if (!options.model.empty()) {
    const Result<ModelFile> file = ModelFile::load(options.model);
    if (!file) return file.status();
    const Result<Estimator> estimator = file_estimator(options.model);
    if (!estimator) return estimator.status();
    return TeachingNetwork{*estimator, file->config().licence};
  }
  const Result<DepthNetwork> network = load_checkpoint(options.checkpoint);
  if (!network) return network.status();
  auto kept = std::make_shared<DepthNetwork>(*network);
  const auto steps = static_cast<int>((*kept)->config.steps.size());
  return TeachingNetwork{[kept, estimate = network_estimator(*kept, steps)](
                             const PackFrame& frame) { return estimate(frame); },
                         (*kept)->config.licence};
}

// What of the maps is not to be believed, kept beside them: whoever trains on them aligns that. The
// scale of our own networks is relative. And under which licence they are.
Status write_note(const fs::path& folder, const Options& options, const std::string& licence) {
  using Gives = TorchscriptOptions::Gives;
  const Gives gives =
      options.torchscript.file.empty() ? Gives::kInverse : options.torchscript.gives;
  const Alignment alignment = gives == Gives::kDepth     ? Alignment::kNone
                              : gives == Gives::kInverse ? Alignment::kScale
                                                         : Alignment::kAffine;
  std::string text;
  for (const auto& [name, value] : alignment_names()) {
    if (value == alignment) text = "{\"align\": \"" + name + "\"";
  }
  if (!licence.empty()) text += ", \"licence\": " + json_quoted(licence);
  text += "}\n";
  std::error_code error;
  fs::create_directories(folder, error);
  return write_file((folder / "teacher.json").string(), text);
}

Status run(const Options& options) {
  const Result<TeachingNetwork> network = teacher_of(options);
  if (!network) return network.status();
  const Estimator teacher = both_ways(network->estimator);
  const fs::path folder = fs::canonical(options.pack);
  PackUse use;
  use.name = folder.filename().string();
  use.teacher = Teacher::kNone;
  use.field_of_view = 60;  // where the pack does not know its camera
  const Result<Pack> pack = load_pack(folder.parent_path(), use, kFullWidth);
  if (!pack) return pack.status();
  const fs::path output = options.output.empty() ? folder / "teacher" : fs::path(options.output);
  LCDM_RETURN_IF_ERROR(write_note(output, options, network->licence));
  std::size_t without = 0;
  for (std::size_t i = 0; i < pack->frames->size(); ++i) {
    const Result<PackFrame> frame = pack->frames->read(i);
    if (!frame) std::fprintf(stderr, "left out: %s\n", frame.status().text());
    const cv::Mat metres = frame ? teacher(*frame) : cv::Mat();
    if (metres.empty()) {
      ++without;
      continue;
    }
    LCDM_RETURN_IF_ERROR(write_map(output / (frame->name + ".png"), metres));
  }
  std::printf("%zu maps in %s\n", pack->frames->size() - without, output.c_str());
  if (without == 0) return Status::ok();
  return Status::error(StatusCode::kCorrupt, "no depth for %zu of %zu frames", without,
                       pack->frames->size());
}

}  // namespace

void add_teach(CLI::App& app, Status& status) {
  auto* command = app.add_subcommand(
      "teach", "Writes a teacher's depth maps for a pack, to learn from (teacher = \"maps\")");
  auto options = std::make_shared<Options>();
  command->add_option("--pack", options->pack, "Folder of the pack (rgb/, intrinsics.json)")
      ->check(CLI::ExistingDirectory)
      ->required();
  command->add_option("--output", options->output, "Folder of the maps (PACK/teacher)");
  auto* teacher = command->add_option_group("teacher", "Who teaches; one of them");
  teacher->add_option("--model", options->model, "A model file exported here")
      ->check(CLI::ExistingFile);
  teacher->add_option("--checkpoint", options->checkpoint, "A training checkpoint")
      ->check(CLI::ExistingFile);
  auto* module =
      teacher->add_option("--torchscript", options->torchscript.file, "A TorchScript module")
          ->check(CLI::ExistingFile);
  teacher->require_option(1);
  command->add_option("--size", options->size, "Width and height the module is fed")
      ->expected(2)
      ->needs(module)
      ->check(CLI::Range(32, 4096))
      ->capture_default_str();
  add_choice(*command, "--pixels", options->torchscript.pixels, pixel_scale_names(),
             "How the module's pictures are scaled: unit ([0, 1]) or imagenet (mean and deviation)")
      ->needs(module);
  const std::map<std::string, TorchscriptOptions::Gives> gives = {
      {"depth", TorchscriptOptions::Gives::kDepth},
      {"inverse", TorchscriptOptions::Gives::kInverse},
      {"affine", TorchscriptOptions::Gives::kAffineInverse}};
  add_choice(*command, "--gives", options->torchscript.gives, gives,
             "What the module gives: depth (metres), inverse (depth of unknown scale; its maps' "
             "median becomes 10 m, align = \"scale\"), affine (inverse depth of unknown scale and "
             "shift, align = \"affine\"); the maps' teacher.json says it to train")
      ->needs(module);
  command->callback([options, &status] { status = run(*options); });
}

}  // namespace lcdm::model
