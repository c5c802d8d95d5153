#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <opencv2/imgcodecs.hpp>

#include "firmware/base/file.h"
#include "model/checkpoint.h"
#include "model/commands.h"
#include "model/csv.h"
#include "model/data_sets.h"
#include "model/evaluation.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;

constexpr int kEngineThreads = 2;

struct Options {
  DataOptions data;
  std::string checkpoint;
  std::vector<int> steps;
  std::string model;
  std::vector<std::string> precisions;
  std::string estimates;
  std::string pack;
  std::string pictures;
  std::string frames;
  bool test = false;
  bool no_scaling = false;
  double blur = 0;
  double share = 1;
};

struct Candidate {
  std::string name;
  Estimator estimator;
};

// One row per frame, candidate and set; without a path nothing is kept.
class FrameTable {
 public:
  explicit FrameTable(std::string path) : path_(std::move(path)) {}

  void add(const std::string& set, const std::string& estimate, const SetResult& result) {
    for (const FrameResult& frame : result.frames) {
      const Metrics& m = frame.metrics;
      char figures[160];
      std::snprintf(figures, sizeof(figures), "%.6g,%.6g,%.6g,%.6g,%.6g,%.6g,%.6g\n", m.abs_rel,
                    m.sq_rel, m.rmse, m.rmse_log, m.delta1, m.delta2, m.delta3);
      text_ +=
          csv_cell(set) + "," + csv_cell(estimate) + "," + csv_cell(frame.name) + "," + figures;
    }
  }

  // Before the first row: a path that cannot be written is told now, not after an hour.
  Status begin() const { return write(""); }
  Status finish() const { return write(text_); }

 private:
  // Not by replace_file: the path may be /dev/stdout.
  Status write(std::string_view text) const {
    if (path_.empty()) return Status::ok();
    const Status written = write_file(path_, text);
    if (written) return written;
    return Status::system(written.sys_errno(), "--frames %s: cannot write", path_.c_str());
  }

  std::string path_;
  std::string text_ = "set,estimate,frame,abs_rel,sq_rel,rmse,rmse_log,d1,d2,d3\n";
};

void print_row(const std::string& set, const std::string& name, const SetResult& result,
               const Difference& to_first) {
  const Metrics& m = result.mean;
  std::printf("| %s | %s | %zu | %.3f | %.3f | %.3f | %.3f | %.3f | %.3f | %.3f |", set.c_str(),
              name.c_str(), result.frames.size(), m.abs_rel, m.sq_rel, m.rmse, m.rmse_log, m.delta1,
              m.delta2, m.delta3);
  if (to_first.frames > 0) {
    std::printf(" %+.3f [%+.3f, %+.3f] |\n", to_first.mean, to_first.low, to_first.high);
  } else {
    std::printf(" |\n");
  }
  std::fflush(stdout);
}

void print_missing(const std::string& set, const std::string& name, const SetResult& result) {
  if (result.missing == 0) return;
  std::fprintf(stderr, "%s, %s: %zu frames could not be measured; the last: %s\n", set.c_str(),
               name.c_str(), result.missing, result.why_missing.text());
}

// At most four frames of a set, evenly spaced.
Status write_pictures(const fs::path& folder, const Pack& pack, const Candidate& candidate) {
  fs::create_directories(folder);
  constexpr std::size_t kMost = 4;
  const std::size_t pictures = std::min(kMost, pack.validation.size());
  for (std::size_t i = 0; i < pictures; ++i) {
    const Result<PackFrame> frame =
        pack.frames->read(pack.validation[i * pack.validation.size() / pictures]);
    if (!frame) continue;
    const cv::Mat estimate = candidate.estimator(*frame);
    if (estimate.empty()) continue;
    std::string name = pack.use.name + "-" + frame->name + "-" + candidate.name + ".png";
    std::replace(name.begin(), name.end(), '/', '-');
    const std::string path = (folder / name).string();
    if (!cv::imwrite(path, comparison_picture(*frame, {estimate}))) {
      return Status::error(StatusCode::kIoError, "--pictures: cannot write %s", path.c_str());
    }
  }
  return Status::ok();
}

// How many frames of the pack the first candidate was measured on; the others stand beside it.
Result<std::size_t> evaluate_pack(const Options& options, const Pack& pack, Protocol protocol,
                                  std::vector<Candidate> candidates, FrameTable& table) {
  if (pack.validation.empty()) return std::size_t{0};
  // Against the teacher's own maps there is nothing to learn about the teacher; and they are of the
  // pictures as they were, not of blurred ones.
  if (const fs::path maps = maps_beside_depth(pack); !maps.empty() && options.blur == 0) {
    candidates.push_back({"teacher " + pack.use.maps, maps_estimator(maps.string())});
  }
  protocol.median_scaling = !options.no_scaling;
  if (protocol.median_scaling) candidates.push_back({"constant", constant_estimator()});
  SetResult first;
  for (const Candidate& candidate : candidates) {
    SetResult result =
        evaluate(*pack.frames, pack.validation, protocol, candidate.estimator, options.blur);
    print_missing(pack.use.name, candidate.name, result);
    const bool is_first = &candidate == &candidates.front();
    if (!result.frames.empty()) {
      print_row(pack.use.name, candidate.name, result,
                is_first ? Difference() : paired_difference(result, first, &Metrics::abs_rel));
      table.add(pack.use.name, candidate.name, result);
    }
    if (is_first) first = std::move(result);
  }
  if (!options.pictures.empty()) {
    LCDM_RETURN_IF_ERROR(write_pictures(options.pictures, pack, candidates.front()));
  }
  return first.frames.size();
}

// Leaves the set that --only names, where it does. kUsage: there is none.
Status keep_asked_for(const Options& options, Data& data) {
  if (options.pack.empty()) return Status::ok();
  const auto found =
      std::find_if(data.packs.begin(), data.packs.end(),
                   [&options](const Pack& pack) { return pack.use.name == options.pack; });
  if (found == data.packs.end()) {
    return Status::error(StatusCode::kUsage, "--only %s: no set of this name among the %s",
                         options.pack.c_str(), options.test ? "test sets" : "training packs");
  }
  data.protocols = {data.protocols[static_cast<std::size_t>(found - data.packs.begin())]};
  data.packs = {*found};
  return Status::ok();
}

Status evaluate_all(const Options& options, const std::vector<Candidate>& candidates) {
  Result<Data> data =
      options.test ? load_test_data(options.data) : load_training_data(options.data);
  if (!data) return data.status();
  LCDM_RETURN_IF_ERROR(keep_asked_for(options, *data));
  LCDM_RETURN_IF_ERROR(require_frames(*data, options.test));
  FrameTable table(options.frames);
  LCDM_RETURN_IF_ERROR(table.begin());
  std::printf(
      "| set | estimate | frames | AbsRel | SqRel | RMSE | RMSElog | d1 | d2 | d3 | AbsRel minus "
      "the "
      "first's [95 %%] |\n|---|---|---|---|---|---|---|---|---|---|---|\n");
  std::size_t measured = 0;
  for (std::size_t i = 0; i < data->packs.size(); ++i) {
    const Pack& pack = data->packs[i];
    const Result<std::size_t> frames =
        evaluate_pack(options, pack, data->protocols[i], candidates, table);
    if (!frames) return frames.status();
    measured += *frames;
  }
  LCDM_RETURN_IF_ERROR(table.finish());
  if (measured > 0) return Status::ok();
  return Status::error(StatusCode::kInvalidInput,
                       "%s could not be measured on any frame (the reasons stand above)",
                       candidates.front().name.c_str());
}

// The device's engine at each precision; says in the end how far its depth was from `exact`.
Status add_precisions(const Options& options, const Estimator& exact,
                      std::vector<Candidate>& candidates) {
  struct Distance {
    explicit Distance(std::string precision) : name(std::move(precision)) {}
    ~Distance() {
      if (frames == 0) return;
      std::printf(
          "%s: log depth differs by %.5f in the mean of %d frames, %.5f in the worst (%s)\n",
          name.c_str(), sum / frames, frames, worst, worst_frame.c_str());
    }
    std::string name;
    double sum = 0;
    double worst = 0;
    std::string worst_frame;
    int frames = 0;
  };
  for (const std::string& name : options.precisions) {
    const auto engine =
        engine_estimator(options.model, *parse_precision(name), kEngineThreads, options.share);
    if (!engine) return engine.status();
    const auto distance = std::make_shared<Distance>(name);
    candidates.push_back({name, [exact, distance, engine = *engine](const PackFrame& frame) {
                            const cv::Mat depth = engine(frame);
                            if (depth.empty()) return depth;  // counted as missing
                            const double here = log_distance(depth, exact(frame));
                            distance->sum += here;
                            if (here >= distance->worst) {
                              distance->worst = here;
                              distance->worst_frame = frame.name;
                            }
                            ++distance->frames;
                            return depth;
                          }});
  }
  return Status::ok();
}

Status run(const Options& options) {
  std::vector<Candidate> candidates;
  DepthNetwork network = nullptr;
  if (!options.checkpoint.empty()) {
    const Result<DepthNetwork> loaded = load_checkpoint(options.checkpoint);
    if (!loaded) return loaded.status();
    network = *loaded;
    std::vector<int> steps = options.steps;
    if (steps.empty()) {
      for (auto n = static_cast<int>(network->config.steps.size()); n >= 0; --n) steps.push_back(n);
    }
    for (const int n : steps) {
      candidates.push_back(
          {std::to_string(n) + "-step", network_estimator(network, n, options.share)});
    }
  }
  if (!options.model.empty()) {
    const Result<Estimator> estimator = file_estimator(options.model, options.share);
    if (!estimator) return estimator.status();
    candidates.push_back({fs::path(options.model).stem().string(), *estimator});
    LCDM_RETURN_IF_ERROR(add_precisions(options, *estimator, candidates));
  }
  if (!options.estimates.empty()) {
    candidates.push_back({"folder", folder_estimator(options.estimates)});
  }
  if (candidates.empty()) {
    return Status::error(StatusCode::kUsage,
                         "nothing to evaluate: give --checkpoint, --model or --estimates");
  }
  return evaluate_all(options, candidates);
}

}  // namespace

void add_evaluate(CLI::App& app, Status& status) {
  auto* command = app.add_subcommand(
      "evaluate", "Seven depth metrics beside a constant depth and the teacher's maps");
  auto options = std::make_shared<Options>();
  add_data_options(*command, options->data);
  auto* checkpoint = command->add_option("--checkpoint", options->checkpoint, "Training checkpoint")
                         ->check(CLI::ExistingFile);
  command
      ->add_option("--steps", options->steps,
                   "Sampling steps of the checkpoint, such as 0 1 2 3 5 10 (0 to its own)")
      ->needs(checkpoint)  // a model file has its own
      ->check(CLI::Range(0, ModelConfig::kDiffusionSteps));
  auto* model = command->add_option("--model", options->model, "Exported model file")
                    ->check(CLI::ExistingFile);
  command
      ->add_option(
          "--precision", options->precisions,
          "The model file (--model) in the device's engine too, at fp32, fp16, bf16 or int8")
      ->needs(model)
      ->check(CLI::IsMember({"fp32", "fp16", "bf16", "int8"}));
  auto* estimates =
      command
          ->add_option("--estimates", options->estimates, "Folder of NAME.tiff or NAME.png depth")
          ->check(CLI::ExistingDirectory);
  command->add_option("--only", options->pack, "Only the set of this name");
  command->add_option("--share", options->share, "Input size as a share of the deployed one")
      ->check(CLI::Range(0.2, 2.0))
      ->capture_default_str();
  command
      ->add_option("--blur", options->blur,
                   "Motion blur of this many pixels of a 640 pixels wide picture")
      ->excludes(estimates)  // they are of the pictures as they were
      ->check(CLI::Range(0.0, 200.0));
  add_test_option(*command, options->test);
  command->add_flag("--no-scaling", options->no_scaling,
                    "Metres as they come, not scaled by the medians");
  command->add_option("--frames", options->frames, "CSV file for the figures of every frame");
  command->add_option("--pictures", options->pictures,
                      "Folder for pictures: frame, truth, first estimate");
  command->callback([options, &status] { status = run(*options); });
}

}  // namespace lcdm::model
