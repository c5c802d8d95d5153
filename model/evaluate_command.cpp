#include <cstdio>
#include <filesystem>
#include <opencv2/imgcodecs.hpp>

#include "model/commands.h"
#include "model/data.h"
#include "model/evaluation.h"
#include "model/trainer.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;

struct Options {
  DataOptions data;
  std::string checkpoint;
  std::string model;
  std::string estimates;
  std::string pack;
  std::string pictures;
  bool test = false;
  double share = 1;
};

struct Candidate {
  std::string name;
  Estimator estimator;
};

void print_row(const std::string& pack, const std::string& name, const PackResult& result) {
  const Metrics& m = result.mean;
  std::printf("| %s | %s | %zu | %.3f | %.3f | %.3f | %.3f | %.3f | %.3f | %.3f |\n", pack.c_str(),
              name.c_str(), result.images.size(), m.abs_rel, m.sq_rel, m.rmse, m.rmse_log, m.delta1,
              m.delta2, m.delta3);
  std::fflush(stdout);
}

// Every eighth frame's picture, at most four of a pack.
void write_pictures(const fs::path& folder, const Pack& pack,
                    const std::vector<std::size_t>& frames, const Candidate& candidate) {
  fs::create_directories(folder);
  const std::size_t stride = std::max<std::size_t>(1, frames.size() / 4);
  for (std::size_t i = 0; i < frames.size(); i += stride) {
    const PackFrame& frame = pack.frames[frames[i]];
    const cv::Mat estimate = candidate.estimator(frame);
    if (estimate.empty()) continue;
    cv::imwrite(
        (folder / (pack.use.name + "-" + frame.name + "-" + candidate.name + ".png")).string(),
        comparison_picture(frame, estimate));
  }
}

void evaluate_pack(const Options& options, const Pack& pack, const std::vector<std::size_t>& frames,
                   std::vector<Candidate> candidates) {
  if (frames.empty()) return;
  // Against the teacher's own maps there is nothing to learn about the teacher.
  if (pack.use.teacher == PackUse::Teacher::kSensor) {
    candidates.push_back({"teacher METER", teacher_estimator(pack.use, options.data.root)});
  }
  candidates.push_back({"constant", constant_estimator()});
  for (const Candidate& candidate : candidates) {
    const PackResult result =
        evaluate(pack, frames, protocol_of(pack.use.name), candidate.estimator);
    if (!result.images.empty()) print_row(pack.use.name, candidate.name, result);
  }
  if (!options.pictures.empty()) {
    write_pictures(options.pictures, pack, frames, candidates.front());
  }
}

Status no_such_pack(const Options& options) {
  return Status::error(StatusCode::kInvalidInput,
                       "--only %s: no pack of this name among the %s packs", options.pack.c_str(),
                       options.test ? "test" : "training");
}

Status evaluate_all(const Options& options, const std::vector<Candidate>& candidates) {
  bool found = options.pack.empty();
  std::printf(
      "| pack | estimate | images | AbsRel | SqRel | RMSE | RMSElog | d1 | d2 | d3 |\n"
      "|---|---|---|---|---|---|---|---|---|---|\n");
  if (!options.test) {
    const Result<std::vector<Pack>> packs = load_training_data(options.data);
    if (!packs) return packs.status();
    for (const Pack& pack : *packs) {
      if (!options.pack.empty() && pack.use.name != options.pack) continue;
      found = true;
      evaluate_pack(options, pack, pack.validation, candidates);
    }
    return found ? Status::ok() : no_such_pack(options);
  }
  for (const PackUse& use : test_packs()) {
    if (!options.pack.empty() && use.name != options.pack) continue;
    found = true;
    const Result<Pack> pack = load_pack(options.data.root, use, 1 << 14, 1);
    if (!pack) return pack.status();
    std::vector<std::size_t> all(pack->frames.size());
    for (std::size_t i = 0; i < all.size(); ++i) all[i] = i;
    evaluate_pack(options, *pack, all, candidates);
  }
  return found ? Status::ok() : no_such_pack(options);
}

Status run(const Options& options) {
  std::vector<Candidate> candidates;
  DepthNetwork network = nullptr;
  if (!options.checkpoint.empty()) {
    const Result<DepthNetwork> loaded = load_checkpoint(options.checkpoint);
    if (!loaded) return loaded.status();
    network = *loaded;
    const int steps = static_cast<int>(network->config.steps.size());
    for (int n = steps; n >= 0; --n) {
      candidates.push_back(
          {std::to_string(n) + "-step", network_estimator(network, n, options.share)});
    }
  }
  if (!options.model.empty()) {
    const Result<Estimator> estimator = file_estimator(options.model, options.share);
    if (!estimator) return estimator.status();
    candidates.push_back({fs::path(options.model).stem().string(), *estimator});
  }
  if (!options.estimates.empty()) {
    candidates.push_back({"folder", folder_estimator(options.estimates)});
  }
  if (candidates.empty()) {
    return Status::error(StatusCode::kInvalidInput,
                         "nothing to evaluate: give --checkpoint, --model or --estimates");
  }
  return evaluate_all(options, candidates);
}

}  // namespace

void add_evaluate(CLI::App& app, Status& status) {
  auto* command = app.add_subcommand(
      "evaluate", "Seven depth metrics, median-scaled, beside a constant depth and the teacher");
  auto options = std::make_shared<Options>();
  add_data_options(*command, options->data);
  command->add_option("--checkpoint", options->checkpoint, "Training checkpoint: 0, 1 and 2 steps")
      ->check(CLI::ExistingFile);
  command->add_option("--model", options->model, "Exported model file")->check(CLI::ExistingFile);
  command->add_option("--estimates", options->estimates, "Folder of NAME.tiff or NAME.png depth")
      ->check(CLI::ExistingDirectory);
  command->add_option("--only", options->pack, "Only the pack of this name");
  command->add_option("--share", options->share, "Input size as a share of the deployed one")
      ->check(CLI::Range(0.2, 2.0))
      ->capture_default_str();
  command->add_flag("--test", options->test, "The test packs instead of the validation parts");
  command->add_option("--pictures", options->pictures,
                      "Folder for pictures: frame, truth, first estimate");
  command->callback([options, &status] { status = run(*options); });
}

}  // namespace lcdm::model
