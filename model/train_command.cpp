#include <algorithm>
#include <cstdio>
#include <filesystem>

#include "model/checkpoint.h"
#include "model/commands.h"
#include "model/data_sets.h"
#include "model/dry_run.h"
#include "model/recipe_options.h"
#include "model/safetensors.h"
#include "model/stop_request.h"
#include "model/trainer.h"
#include "model/training_log.h"
#include "model/unfolder.h"
#include "model/validation.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kValidationFrames = 24;  // of each pack

struct Options {
  RecipeOptions recipe;
  ComputeOptions compute;
  DataOptions data;
  std::string output = "build/training";
  bool resume = false;
  bool dry_run = false;
  std::string from;
  std::string encoder_weights;
  bool encoder_bgr = false;
  std::string pose_weights;
  std::int64_t save_every = 200;
  std::int64_t validate_every = 0;
};

void print_import(const char* what, const std::string& path, const ImportReport& report) {
  std::printf("%s: %zu tensors from %s", what, report.taken, path.c_str());
  for (std::size_t i = 0; i < report.unused.size(); ++i) {
    std::printf("%s%s", i == 0 ? "; not used: " : ", ", report.unused[i].c_str());
  }
  std::printf("\n");
}

Status start_from(const std::string& path, Trainer& trainer) {
  const Result<bool> checkpoint = is_checkpoint(path);
  if (!checkpoint) return checkpoint.status();
  const auto network = *checkpoint ? load_checkpoint(path) : unfold_model(path);
  if (!network) return network.status();
  return trainer.start_from(*network,
                            *checkpoint ? NormStatistics::kKept : NormStatistics::kMissing);
}

// Weights trained before, or by others, where the options name them.
Status start_from_trained(const Options& options, Trainer& trainer) {
  if (!options.from.empty()) {
    LCDM_RETURN_IF_ERROR(start_from(options.from, trainer));
    std::printf("started from %s\n", options.from.c_str());
  }
  if (!options.encoder_weights.empty()) {
    const auto file = read_tensors(options.encoder_weights);
    if (!file) return file.status();
    const auto order = options.encoder_bgr ? ChannelOrder::kBgr : ChannelOrder::kRgb;
    const auto report = trainer.start_encoder_from(*file, order);
    if (!report) return report.status();
    print_import("encoder", options.encoder_weights, *report);
  }
  if (!options.pose_weights.empty()) {
    const auto file = read_tensors(options.pose_weights);
    if (!file) return file.status();
    const auto report = trainer.start_pose_from(*file);
    if (!report) return report.status();
    print_import("pose encoder", options.pose_weights, *report);
  }
  return Status::ok();
}

fs::path checkpoint_in(const fs::path& folder) { return folder / "checkpoint.safetensors"; }
fs::path best_in(const fs::path& folder) { return folder / "best.safetensors"; }

// The folder of a run: checkpoint.safetensors is the last state, best.safetensors the one with the
// best validation score.
class Run {
 public:
  Run(const Options& options, const Recipe& recipe, const Data& data, Trainer& trainer, bool leads)
      : options_(options),
        recipe_(recipe),
        data_(data),
        trainer_(trainer),
        leads_(leads),
        folder_(options.output) {}

  std::string last() const { return checkpoint_in(folder_).string(); }

  Status train(Processes& processes) {
    std::optional<TrainingLog> log;
    const std::int64_t begun = trainer_.step();
    if (leads_) log.emplace(folder_, begun, recipe_.steps);
    while (!trainer_.done()) {
      const Result<bool> stops = processes.any(must_stop());
      if (stops && *stops) break;
      const Result<Losses> losses = stops ? trainer_.advance() : stops.status();
      if (!losses) {
        if (leads_ && trainer_.step() > begun && spares_weights(losses.status())) save_for_later();
        return losses.status();
      }
      if (!log) continue;
      log->add(trainer_, *losses);
      if (is_time(options_.validate_every)) LCDM_RETURN_IF_ERROR(keep_the_best(*log));
      if (is_time(options_.save_every)) LCDM_RETURN_IF_ERROR(trainer_.save(last()));
    }
    const std::string note = trainer_.frames().note();
    if (!note.empty()) std::fprintf(stderr, "%s\n", note.c_str());
    for (const LearnedFocal& focal : trainer_.learned_focals()) {
      if (!leads_) break;
      std::printf("%s: focal lengths fx %.3f, fy %.3f times the assumed ones\n", focal.pack.c_str(),
                  focal.fx, focal.fy);
    }
    return leads_ ? trainer_.save(last()) : Status::ok();
  }

 private:
  // Whether frames could not be read, or another process has gone: the weights are then as good as
  // they were. A fault of the training itself (kCorrupt too) may have spoilt them before it was
  // noticed.
  bool spares_weights(const Status& fault) const {
    return fault.code() != StatusCode::kCorrupt || !trainer_.frames().check();
  }

  void save_for_later() const {
    const Status saved = trainer_.save(last());
    if (!saved) {
      std::fprintf(stderr, "what was trained is lost: %s\n", saved.text());
      return;
    }
    std::fprintf(stderr, "saved at step %lld: mend what stopped it and go on with --resume\n",
                 static_cast<long long>(trainer_.step()));
  }

  bool is_time(std::int64_t every) const {
    return every > 0 && (trainer_.step() % every == 0 || trainer_.done());
  }

  Status keep_the_best(TrainingLog& log) {
    const int steps = trainer_.has_head() ? static_cast<int>(trainer_.config().steps.size()) : 0;
    const Validation validation =
        validate(trainer_.averaged(), steps, trainer_.share(), data_, kValidationFrames);
    if (!validation.fault) {
      std::fprintf(stderr, "step %lld: no score, a set could not be measured: %s\n",
                   static_cast<long long>(trainer_.step()), validation.fault.text());
    }
    if (validation.missing > 0) {
      std::fprintf(stderr, "step %lld: validated without %zu frames that cannot be read\n",
                   static_cast<long long>(trainer_.step()), validation.missing);
    }
    const bool better = trainer_.update_best(validation.score);
    log.add(trainer_, validation, better);
    return better ? trainer_.save(best_in(folder_).string()) : Status::ok();
  }

  const Options& options_;
  const Recipe& recipe_;
  const Data& data_;
  Trainer& trainer_;
  bool leads_;
  fs::path folder_;
};

// Of weights trained on `data`: those they started from, or this run's own, ask for something too.
std::string licence_of(const ModelConfig& config, const Data& data) {
  if (config.licence.empty() || config.licence == data.licence) return data.licence;
  if (config.licence.rfind(data.licence, 0) == 0) return config.licence;  // a run that goes on
  return data.licence + "; started from weights under: " + config.licence;
}

// A new training would replace the folder's checkpoint, best state and curve.
Status require_unused(const Options& options) {
  const bool used =
      fs::exists(checkpoint_in(options.output)) || fs::exists(best_in(options.output));
  if (options.resume || options.dry_run || !used) return Status::ok();
  return Status::error(StatusCode::kUsage,
                       "--output %s holds a training: give --resume or another --output",
                       options.output.c_str());
}

// Without a frame to measure on no state is better than another.
Status require_validation(const Options& options, const Data& data) {
  const bool none = std::all_of(data.packs.begin(), data.packs.end(),
                                [](const Pack& pack) { return pack.validation.empty(); });
  if (options.validate_every == 0 || !none) return Status::ok();
  return Status::error(StatusCode::kUsage,
                       "--validate-every: nothing to validate on: sequences under 34 frames only "
                       "train; leave it out, or give more data");
}

Status resume(const Options& options, Trainer& trainer, const std::string& checkpoint, bool leads) {
  const Result<std::string> changed = trainer.resume(checkpoint);
  if (!changed) return changed.status();
  if (!leads) return Status::ok();
  for (const std::string& start : {options.from, options.encoder_weights, options.pose_weights}) {
    if (start.empty()) continue;
    std::fprintf(stderr, "%s is not used with --resume: goes on from %s\n", start.c_str(),
                 checkpoint.c_str());
  }
  if (!changed->empty()) {
    std::fprintf(stderr, "goes on with other options or data than it had:\n%s", changed->c_str());
  }
  if (trainer.done()) {
    std::fprintf(stderr, "nothing left to do: %s is at step %lld; give more --steps\n",
                 checkpoint.c_str(), static_cast<long long>(trainer.step()));
  }
  return Status::ok();
}

Status run(const Options& options) {
  LCDM_RETURN_IF_ERROR(require_unused(options));
  const Result<Recipe> recipe = recipe_of(options.recipe);
  if (!recipe) return recipe.status();
  const Result<Compute> compute = compute_of(options.compute);
  if (!compute) return compute.status();
  const Result<Data> data = load_training_data(options.data);
  if (!data) return data.status();
  LCDM_RETURN_IF_ERROR(require_validation(options, *data));
  if (options.dry_run) return dry_run(*recipe, data->packs, *compute);

  std::error_code error;
  fs::create_directories(options.output, error);
  if (error) {
    return Status::system(error.value(), "--output %s: cannot make this folder",
                          options.output.c_str());
  }
  const auto trainer = Trainer::make(*recipe, data->packs, *compute);
  if (!trainer) return trainer.status();
  const bool leads = compute->processes->rank() == 0;
  Run training(options, *recipe, *data, **trainer, leads);
  if (options.resume) {
    LCDM_RETURN_IF_ERROR(resume(options, **trainer, training.last(), leads));
  } else {
    LCDM_RETURN_IF_ERROR(start_from_trained(options, **trainer));
  }
  const std::string licence = licence_of((*trainer)->config(), *data);
  LCDM_RETURN_IF_ERROR((*trainer)->set_licence(licence));
  if (leads) {
    const ModelConfig& config = (*trainer)->config();
    std::printf("variable mean %.4f deviation %.4f, from step %lld\nlicence of the weights: %s\n",
                config.variable_mean, config.variable_std,
                static_cast<long long>((*trainer)->step()), licence.c_str());
  }
  stop_on_signals();
  return training.train(*compute->processes);
}

}  // namespace

void add_train(CLI::App& app, Status& status) {
  auto* command =
      app.add_subcommand("train", "Trains a network; Ctrl-C or a closed terminal saves and stops");
  auto options = std::make_shared<Options>();
  add_data_options(*command, options->data);
  add_recipe_options(*command, options->recipe);
  add_compute_options(*command, options->compute);
  command
      ->add_option("--output", options->output,
                   "Folder of the checkpoints, curve.csv and validation.csv")
      ->capture_default_str();
  command->add_flag("--resume", options->resume, "Go on from the folder's last checkpoint");
  command->add_flag("--dry-run", options->dry_run,
                    "Print parameters, MACs, host memory and expected time, and stop");
  command
      ->add_option(
          "--from", options->from,
          "Start the depth network from this checkpoint or model file, of the same or a smaller "
          "encoder")
      ->check(CLI::ExistingFile);
  auto* encoder =
      command
          ->add_option("--encoder-weights", options->encoder_weights,
                       "Start the encoder from this .safetensors (timm's or ml-cvnets' names)")
          ->check(CLI::ExistingFile);
  command->add_flag("--encoder-bgr", options->encoder_bgr, "They were trained on BGR pictures")
      ->needs(encoder);
  command
      ->add_option("--pose-weights", options->pose_weights,
                   "Start the pose network's ResNet18 from this .safetensors (torchvision's names)")
      ->check(CLI::ExistingFile);
  command->add_option("--save-every", options->save_every, "Steps between checkpoints")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command
      ->add_option("--validate-every", options->validate_every,
                   "Steps between validations; the best state is kept as best.safetensors")
      ->check(CLI::PositiveNumber);
  command->callback([options, &status] { status = run(*options); });
}

}  // namespace lcdm::model
