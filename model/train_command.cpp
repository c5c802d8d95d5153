#include <chrono>
#include <csignal>
#include <cstdio>
#include <filesystem>
#include <unistd.h>

#include "model/commands.h"
#include "model/data.h"
#include "model/safetensors.h"
#include "model/trainer.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

volatile std::sig_atomic_t stop_asked = 0;

struct Options {
  Recipe recipe;
  DataOptions data;
  std::string output = "build/training";
  bool resume = false;
  std::string encoder_weights;
  bool encoder_bgr = false;
  std::string pose_weights;
  std::int64_t save_every = 200;
};

// Means of the losses since the last line, the rate and the time left: redrawn in place on a
// terminal, one line per `kLines` steps otherwise, and one row of the curve.
class Progress {
 public:
  Progress(const fs::path& curve, std::int64_t first, std::int64_t total)
      : terminal_(isatty(STDOUT_FILENO) != 0), first_(first), total_(total), start_(Clock::now()) {
    const bool fresh = !fs::exists(curve);
    curve_ = std::fopen(curve.c_str(), "a");
    if (curve_ != nullptr && fresh) {
      std::fprintf(curve_, "step,images,seconds,learning_rate");
      for (const char* name : kTermNames) std::fprintf(curve_, ",%s", name);
      std::fprintf(curve_, "\n");
    }
  }
  ~Progress() {
    if (curve_ != nullptr) std::fclose(curve_);
    if (terminal_) std::printf("\n");
  }
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  void add(const Trainer& trainer, const Losses& losses) {
    for (std::size_t i = 0; i < sums_.size(); ++i) sums_[i] += losses.terms[i];
    ++count_;
    if (trainer.step() % kLines != 0 && !trainer.done()) return;
    print(trainer);
    sums_ = {};
    count_ = 0;
  }

 private:
  static constexpr std::int64_t kLines = 25;

  void print(const Trainer& trainer) {
    const double seconds = std::chrono::duration<double>(Clock::now() - start_).count();
    const double per_step = seconds / static_cast<double>(trainer.step() - first_);
    const double left = per_step * static_cast<double>(total_ - trainer.step());
    const double n = static_cast<double>(count_);
    std::printf("%s%lld/%lld  %.2f s/step  %.0f min left", terminal_ ? "\r" : "",
                static_cast<long long>(trainer.step()), static_cast<long long>(total_), per_step,
                left / 60);
    for (std::size_t i = 0; i < sums_.size(); ++i) {
      if (sums_[i] != 0) std::printf("  %s %.4f", kTermNames[i], sums_[i] / n);
    }
    std::printf("%s", terminal_ ? "  " : "\n");
    std::fflush(stdout);
    if (curve_ == nullptr) return;
    std::fprintf(curve_, "%lld,%lld,%.1f,%.3g", static_cast<long long>(trainer.step()),
                 static_cast<long long>(trainer.images()), seconds, trainer.learning_rate());
    for (const double sum : sums_) std::fprintf(curve_, ",%.5f", sum / n);
    std::fprintf(curve_, "\n");
    std::fflush(curve_);
  }

  bool terminal_;
  std::int64_t first_;
  std::int64_t total_;
  Clock::time_point start_;
  std::FILE* curve_ = nullptr;
  std::array<double, kTermNames.size()> sums_{};
  int count_ = 0;
};

void print_import(const char* what, const std::string& path, const ImportReport& report) {
  std::printf("%s: %zu tensors from %s", what, report.taken, path.c_str());
  for (std::size_t i = 0; i < report.unused.size(); ++i) {
    std::printf("%s%s", i == 0 ? "; not used: " : ", ", report.unused[i].c_str());
  }
  std::printf("\n");
}

// Weights that others trained, where the options name them.
Status start_from_others(const Options& options, Trainer& trainer) {
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

Status run(const Options& options) {
  const Result<std::vector<Pack>> packs = load_training_data(options.data);
  if (!packs) return packs.status();
  std::error_code error;
  fs::create_directories(options.output, error);
  if (error) {
    return Status::system(error.value(), "--output %s: cannot make this folder",
                          options.output.c_str());
  }
  const std::string checkpoint = (fs::path(options.output) / "checkpoint.safetensors").string();
  Trainer trainer(options.recipe, *packs);
  if (options.resume) {
    LCDM_RETURN_IF_ERROR(trainer.resume(checkpoint));
  } else {
    LCDM_RETURN_IF_ERROR(start_from_others(options, trainer));
  }
  std::printf("variable mean %.4f deviation %.4f, from step %lld\n", trainer.config().variable_mean,
              trainer.config().variable_std, static_cast<long long>(trainer.step()));

  std::signal(SIGTERM, [](int) { stop_asked = 1; });
  std::signal(SIGINT, [](int) { stop_asked = 1; });
  Progress progress(fs::path(options.output) / "curve.csv", trainer.step(), options.recipe.steps);
  while (!trainer.done() && stop_asked == 0) {
    const Result<Losses> losses = trainer.advance();
    if (!losses) return losses.status();
    progress.add(trainer, *losses);
    if (trainer.step() % options.save_every == 0) LCDM_RETURN_IF_ERROR(trainer.save(checkpoint));
  }
  return trainer.save(checkpoint);
}

}  // namespace

void add_train(CLI::App& app, Status& status) {
  auto* command = app.add_subcommand("train", "Trains a network; Ctrl-C saves and stops");
  auto options = std::make_shared<Options>();
  Recipe& recipe = options->recipe;
  add_data_options(*command, options->data);
  command->add_option("--output", options->output, "Folder of the checkpoint and curve.csv")
      ->capture_default_str();
  command->add_flag("--resume", options->resume, "Go on from the folder's checkpoint");
  command
      ->add_option("--encoder-weights", options->encoder_weights,
                   "Start the encoder from this .safetensors (timm's or ml-cvnets' names)")
      ->check(CLI::ExistingFile);
  command->add_flag("--encoder-bgr", options->encoder_bgr, "They were trained on BGR pictures");
  command
      ->add_option("--pose-weights", options->pose_weights,
                   "Start the pose network's ResNet18 from this .safetensors (torchvision's names)")
      ->check(CLI::ExistingFile);
  command->add_option("--save-every", options->save_every, "Steps between checkpoints")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  const std::map<std::string, EncoderKind> encoders = {
      {"xxs", EncoderKind::kXxs}, {"xs", EncoderKind::kXs}, {"s", EncoderKind::kS}};
  const std::map<std::string, PresetKind> presets = {{"lcdm", PresetKind::kLcdm},
                                                     {"paper", PresetKind::kPaper}};
  const std::map<std::string, StartKind> starts = {{"noise", StartKind::kNoise},
                                                   {"zeros", StartKind::kZeros}};
  command->add_option("--start", recipe.start, "Where the sampler starts: noise or zeros")
      ->transform(CLI::CheckedTransformer(starts));
  command->add_option("--encoder", recipe.encoder, "xxs, xs or s")
      ->transform(CLI::CheckedTransformer(encoders));
  command->add_option("--preset", recipe.preset, "lcdm or paper")
      ->transform(CLI::CheckedTransformer(presets));
  command->add_option("--seed", recipe.seed, "Of weights, batches and noise")
      ->capture_default_str();
  command->add_option("--steps", recipe.steps, "Optimiser steps in all")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--reduced", recipe.reduced, "Share of the deployed size at first")
      ->check(CLI::Range(0.2, 1.0))
      ->capture_default_str();
  command
      ->add_option(
          "--head-from", recipe.head_from,
          "Share of the steps before which only encoder, decoder and the 0-step answer train")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  command
      ->add_option(
          "--workers", recipe.workers,
          "Threads that train on a part of each batch (the weights depend on their number)")
      ->check(CLI::Range(1, 256))
      ->capture_default_str();
  command
      ->add_option("--full-from", recipe.full_from,
                   "Share of the steps after which pictures have the deployed size")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  command
      ->add_option("--freeze-from", recipe.freeze_from,
                   "Share of the steps after which batch-norm statistics are frozen")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  command->add_option("--images", recipe.images, "Pictures in a batch at the reduced size")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--full-images", recipe.full_images, "And at the deployed size")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--learning-rate", recipe.learning_rate, "At its highest")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--final-rate", recipe.final_rate, "At the end of the cosine")
      ->capture_default_str();
  command->add_option("--warm-up", recipe.warm_up, "Steps to the highest rate")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--weight-decay", recipe.weight_decay, "Of AdamW")->capture_default_str();
  command->add_option("--clip", recipe.clip, "Largest norm of the gradient")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--average", recipe.average, "Of the moving average of the weights")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  LossWeights& weights = recipe.losses;
  const auto add_weight = [command](const char* name, double& weight, const char* what) {
    command->add_option(name, weight, what)->check(CLI::NonNegativeNumber)->capture_default_str();
  };
  add_weight("--distillation", weights.distillation, "Weight of the depth distillation");
  add_weight("--denoising", weights.denoising, "Weight of the denoising loss");
  add_weight("--normals", weights.normals, "Weight of the surface-normal distillation");
  add_weight("--photometric", weights.photometric, "Weight of the photometric loss");
  add_weight("--smoothness", weights.smoothness, "Weight of the edge-aware smoothness");
  add_weight("--gradient", weights.gradient, "Weight of the gradient loss");
  add_weight("--direct", weights.direct, "Weight of the 0-step answer's losses");
  command->callback([options, &status] { status = run(*options); });
}

}  // namespace lcdm::model
