#include "model/trainer.h"

#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <numbers>
#include <system_error>
#include <torch/nn/utils/clip_grad.h>
#include <torch/optim/adamw.h>
#include <torch/serialize.h>
#include <unistd.h>

#include "model/batches.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

// Exponentially smoothed losses for the log and the progress line.
struct RunningLosses {
  StepLosses mean;
  std::int64_t count = 0;

  void add(const StepLosses& step) {
    const double keep = count++ == 0 ? 0 : 0.98;
    const auto mix = [keep](double& value, double with) {
      value = keep * value + (1 - keep) * with;
    };
    mix(mean.denoising, step.denoising);
    mix(mean.distillation, step.distillation);
    mix(mean.gradient, step.gradient);
    mix(mean.direct, step.direct);
  }
};

class Progress {
 public:
  Progress(std::int64_t first, std::int64_t last, int batch_size)
      : first_(first),
        last_(last),
        batch_size_(batch_size),
        terminal_(isatty(STDOUT_FILENO) == 1) {}

  void show(std::int64_t step, const StepLosses& losses, double rate) {
    const double seconds = std::chrono::duration<double>(Clock::now() - begin_).count();
    const double per_step = seconds / static_cast<double>(std::max<std::int64_t>(1, step - first_));
    const double left = per_step * static_cast<double>(last_ - step);
    if (!terminal_ && step % 100 != 0 && step != last_) return;
    std::printf(
        "%sstep %lld/%lld  %.1f images/s  %.0f min left  lr %.1e  denoise %.4f  "
        "depth %.4f  gradient %.4f  direct %.4f%s",
        terminal_ ? "\r" : "", static_cast<long long>(step), static_cast<long long>(last_),
        batch_size_ / per_step, left / 60, rate, losses.denoising, losses.distillation,
        losses.gradient, losses.direct, terminal_ && step != last_ ? "  " : "\n");
    std::fflush(stdout);
  }

 private:
  const std::int64_t first_, last_;
  const int batch_size_;
  const bool terminal_;
  const Clock::time_point begin_ = Clock::now();
};

void set_rate(torch::optim::AdamW& optimizer, double rate) {
  for (auto& group : optimizer.param_groups()) {
    static_cast<torch::optim::AdamWOptions&>(group.options()).lr(rate);
  }
}

// Convolution weights and pictures with channels innermost: what oneDNN runs fastest.
void use_channels_last(torch::nn::Module& net) {
  for (torch::Tensor& parameter : net.parameters()) {
    if (parameter.dim() == 4) {
      parameter.set_data(parameter.contiguous(torch::MemoryFormat::ChannelsLast));
    }
  }
}

// Batch statistics stay as they are; the weights go on learning.
void freeze_norms(torch::nn::Module& net) {
  for (const auto& module : net.modules()) {
    if (auto* norm = module->as<torch::nn::BatchNorm2d>()) norm->eval();
  }
}

Status save_checkpoint(const std::string& path, DepthNet& net, torch::optim::AdamW& optimizer,
                       torch::Generator& generator, std::int64_t step) {
  return save_atomically(path, [&](const std::string& file) {
    torch::serialize::OutputArchive archive, net_archive, optimizer_archive;
    net->save(net_archive);
    optimizer.save(optimizer_archive);
    archive.write("net", net_archive);
    archive.write("optimizer", optimizer_archive);
    archive.write("random", generator.get_state());
    archive.write("step", torch::tensor(step));
    archive.save_to(file);
  });
}

Result<std::int64_t> load_checkpoint(const std::string& path, DepthNet& net,
                                     torch::optim::AdamW& optimizer, torch::Generator& generator) {
  try {
    torch::serialize::InputArchive archive, net_archive, optimizer_archive;
    archive.load_from(path);
    archive.read("net", net_archive);
    net->load(net_archive);
    archive.read("optimizer", optimizer_archive);
    optimizer.load(optimizer_archive);
    torch::Tensor random, step;
    archive.read("random", random);
    generator.set_state(random);
    archive.read("step", step);
    return step.item<std::int64_t>();
  } catch (const std::exception&) {
    return Status::error(StatusCode::kCorrupt,
                         "%s: not a checkpoint of this network: remove it to begin anew, or give "
                         "the options it was made with",
                         path.c_str());
  }
}

}  // namespace

double learning_rate_at(const TrainOptions& options, std::int64_t step) {
  if (step < options.warmup_steps) {
    return options.learning_rate * static_cast<double>(step + 1) /
           static_cast<double>(options.warmup_steps);
  }
  const double share =
      static_cast<double>(step - options.warmup_steps) /
      static_cast<double>(std::max<std::int64_t>(1, options.steps - options.warmup_steps));
  const double cosine = (1 + std::cos(std::numbers::pi * std::min(1.0, share))) / 2;
  return options.last_learning_rate + (options.learning_rate - options.last_learning_rate) * cosine;
}

Status save_atomically(const std::string& path,
                       const std::function<void(const std::string&)>& write) {
  const std::string partial = path + ".partial";
  std::error_code error;
  try {
    write(partial);
    fs::rename(partial, path);
    return Status::ok();
  } catch (const std::exception& failure) {
    fs::remove(partial, error);
    return Status::error(StatusCode::kIoError,
                         "cannot write %s (is the disk full?); what stood there before is intact",
                         path.c_str());
  }
}

Status train(DepthNet& net, const std::vector<Source>& sources, const TrainOptions& options,
             const std::function<bool()>& stop_requested) {
  std::error_code error;
  fs::create_directories(options.output, error);
  if (error) {
    return Status::system(error.value(), "cannot make the folder %s", options.output.c_str());
  }
  torch::optim::AdamW optimizer(
      net->parameters(),
      torch::optim::AdamWOptions(options.learning_rate).weight_decay(options.weight_decay));
  torch::Generator generator = at::detail::createCPUGenerator(options.seed);
  const std::string checkpoint = options.output + "/checkpoint.pt";
  std::int64_t step = 0;
  if (fs::exists(checkpoint)) {
    const auto resumed = load_checkpoint(checkpoint, net, optimizer, generator);
    if (!resumed) return resumed.status();
    step = *resumed;
    std::printf("resuming at step %lld\n", static_cast<long long>(step));
  }

  BatchMaker::Options batching;
  batching.shapes = options.shapes;
  batching.batch_size = options.batch_size;
  batching.canonical_focal = net->config.canonical_focal;
  batching.seed = options.seed;
  batching.first = static_cast<std::uint64_t>(step);
  BatchMaker batches(sources, batching);

  std::ofstream log(options.output + "/log.csv", std::ios::app);
  if (step == 0) log << "step,learning_rate,denoising,distillation,gradient,direct\n";
  Progress progress(step, options.steps, options.batch_size);
  RunningLosses running;
  use_channels_last(*net);
  net->train();
  const auto freeze_at =
      static_cast<std::int64_t>(options.freeze_norm_at * static_cast<double>(options.steps));
  if (step > freeze_at) freeze_norms(*net);

  while (step < options.steps) {
    if (step == freeze_at) freeze_norms(*net);
    Batch batch = batches.next();
    batch.image = batch.image.contiguous(torch::MemoryFormat::ChannelsLast);
    const double rate = learning_rate_at(options, step);
    set_rate(optimizer, rate);
    optimizer.zero_grad();
    const StepLosses losses = training_losses(net, batch, options.weights, generator);
    const double total = losses.total.item<double>();
    if (!std::isfinite(total)) {
      return Status::error(StatusCode::kInvalidInput,
                           "the loss is %f at step %lld (denoise %f, depth %f, gradient %f): lower "
                           "the learning rate and resume; the last checkpoint is intact",
                           total, static_cast<long long>(step), losses.denoising,
                           losses.distillation, losses.gradient);
    }
    losses.total.backward();
    torch::nn::utils::clip_grad_norm_(net->parameters(), options.clip_norm);
    optimizer.step();
    ++step;

    running.add(losses);
    progress.show(step, running.mean, rate);
    if (step % 100 == 0) {
      log << step << ',' << rate << ',' << running.mean.denoising << ','
          << running.mean.distillation << ',' << running.mean.gradient << ',' << running.mean.direct
          << std::endl;
    }
    const bool stop = stop_requested();
    if (stop || step == options.steps || step % options.checkpoint_every == 0) {
      LCDM_RETURN_IF_ERROR(save_checkpoint(checkpoint, net, optimizer, generator, step));
    }
    if (stop) break;
  }
  return Status::ok();
}

}  // namespace lcdm::model
