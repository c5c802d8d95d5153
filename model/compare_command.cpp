// lcdm-train compare: the engine beside other runtimes on the same network, interleaved.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <ctime>
#include <fcntl.h>
#include <functional>
#include <memory>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>

#include "firmware/base/os.h"
#include "firmware/nn/engine.h"
#include "model/commands.h"
#include "model/folded_net.h"
#include "model/onnx_export.h"

namespace lcdm::model {
namespace {

struct Options {
  std::string model;
  std::vector<std::string> peers;
  std::string onnx = "build/compare.onnx";
  int width = 640;
  int height = 192;
  int rounds = 30;
  int frames = 5;
};

// Between two runtimes: threads of the one that spin on (ONNX Runtime's do) would take the other's
// processors.
constexpr std::chrono::milliseconds kPause{100};

// Milliseconds of the median frame of one round.
struct Timing {
  double wall = 0;
  double cpu = 0;  // of all threads
};

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

double quantile(std::vector<double> values, double q) {
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(q * static_cast<double>(values.size() - 1) + 0.5)];
}

double cpu_milliseconds() {
  timespec now{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) * 1e3 + static_cast<double>(now.tv_nsec) * 1e-6;
}

Timing time_frames(int frames, const std::function<void()>& run) {
  std::vector<double> wall;
  std::vector<double> cpu;
  for (int i = 0; i < frames; ++i) {
    const std::int64_t begin = os::monotonic_ns();
    const double used = cpu_milliseconds();
    run();
    cpu.push_back(cpu_milliseconds() - used);
    wall.push_back(static_cast<double>(os::monotonic_ns() - begin) * 1e-6);
  }
  return {median(wall), median(cpu)};
}

// The picture that every runtime is given (peers/onnxruntime.mjs makes the same), [3, H, W] or
// [H, W, 3] in [0, 1].
std::vector<float> test_picture(const Options& options) {
  std::vector<float> values(static_cast<std::size_t>(options.width * options.height) * 3);
  for (std::size_t i = 0; i < values.size(); ++i) {
    values[i] = 0.5F + 0.5F * std::sin(static_cast<float>(i) * 0.37F);
  }
  return values;
}

// Something that runs the network. nullopt where it broke.
struct Runner {
  std::string name;
  std::function<std::optional<Timing>(int frames)> run;
};

// Nothing where this processor computes in a wider precision than that.
Status add_engine(const ModelFile& file, const Options& options, Precision precision,
                  std::vector<Runner>& runners) {
  EngineOptions wanted;
  wanted.width = options.width;
  wanted.height = options.height;
  wanted.threads = at::get_num_threads();
  wanted.precision = precision;
  const CameraModel camera = CameraModel::from_field_of_view(options.width, options.height, 65);
  auto prepared = Engine::prepare(
      file, wanted, {PixelFormat::kRgb24, options.width, options.height, options.width * 3},
      camera);
  if (!prepared) return prepared.status();
  const std::shared_ptr<Engine> engine = std::move(*prepared);
  if (engine->stats().precision != precision) return Status::ok();
  const std::vector<float> image = test_picture(options);
  const auto run = [engine, image](int frames) -> std::optional<Timing> {
    bool good = true;
    const Timing timing =
        time_frames(frames, [&] { good = good && static_cast<bool>(engine->run_network(image)); });
    if (!good) return std::nullopt;
    return timing;
  };
  runners.push_back({std::string("engine ") + to_string(precision), run});
  return Status::ok();
}

Runner libtorch_runner(const ModelFile& file, const Options& options) {
  const auto net = std::make_shared<FoldedNet>(file);
  const torch::Tensor image = torch::tensor(test_picture(options))
                                  .view({1, 3, options.height, options.width})
                                  .contiguous(torch::MemoryFormat::ChannelsLast);
  return {"LibTorch", [net, image](int frames) -> std::optional<Timing> {
            return time_frames(frames, [&] { net->forward(image); });
          }};
}

// A program that runs N frames for every line N it reads and answers "WALL CPU".
class PeerProcess {
 public:
  explicit PeerProcess(const std::string& command) {
    int to_child[2];
    int from_child[2];
    LCDM_CHECK(pipe2(to_child, O_CLOEXEC) == 0 && pipe2(from_child, O_CLOEXEC) == 0);
    child_ = fork();
    LCDM_CHECK(child_ >= 0);
    if (child_ == 0) {
      dup2(to_child[0], STDIN_FILENO);
      dup2(from_child[1], STDOUT_FILENO);
      execl("/bin/sh", "sh", "-c", command.c_str(), nullptr);
      _exit(127);
    }
    close(to_child[0]);
    close(from_child[1]);
    in_ = fdopen(to_child[1], "w");
    out_ = fdopen(from_child[0], "r");
  }
  ~PeerProcess() {
    std::fclose(in_);
    std::fclose(out_);
    waitpid(child_, nullptr, 0);
  }
  PeerProcess(const PeerProcess&) = delete;
  PeerProcess& operator=(const PeerProcess&) = delete;

  std::optional<Timing> run(int frames) {
    Timing timing;
    if (std::fprintf(in_, "%d\n", frames) < 0 || std::fflush(in_) != 0 ||
        std::fscanf(out_, "%lf %lf", &timing.wall, &timing.cpu) != 2) {
      return std::nullopt;
    }
    return timing;
  }

 private:
  pid_t child_ = -1;
  std::FILE* in_ = nullptr;
  std::FILE* out_ = nullptr;
};

Runner peer_runner(const std::string& command) {
  const auto process = std::make_shared<PeerProcess>(command);
  return {command, [process](int frames) { return process->run(frames); }};
}

// "median (quartiles)" of runner i's time over runner e's, round by round.
std::string ratio_text(const std::vector<std::vector<Timing>>& rounds, std::size_t i, std::size_t e,
                       double Timing::*what) {
  std::vector<double> ratios;
  for (const std::vector<Timing>& round : rounds) ratios.push_back(round[i].*what / round[e].*what);
  char text[64];
  std::snprintf(text, sizeof(text), "%.2f (%.2f to %.2f)", median(ratios), quantile(ratios, 0.25),
                quantile(ratios, 0.75));
  return text;
}

// The first `engines` runners are ours, one for each precision.
void print_table(const std::vector<Runner>& runners, std::size_t engines,
                 const std::vector<std::vector<Timing>>& rounds) {
  std::string head = "| runtime | wall ms | worst round / median | CPU ms |";
  std::string rule = "|---|---|---|---|";
  for (std::size_t e = 0; e < engines; ++e) {
    head += " CPU over " + runners[e].name + "'s (quartiles) | wall |";
    rule += "---|---|";
  }
  std::printf("%s\n%s\n", head.c_str(), rule.c_str());
  for (std::size_t i = 0; i < runners.size(); ++i) {
    std::vector<double> wall;
    std::vector<double> cpu;
    for (const std::vector<Timing>& round : rounds) {
      wall.push_back(round[i].wall);
      cpu.push_back(round[i].cpu);
    }
    std::printf("| %s | %.1f | %.2f | %.1f |", runners[i].name.c_str(), median(wall),
                quantile(wall, 1) / median(wall), median(cpu));
    for (std::size_t e = 0; e < engines; ++e) {
      std::printf(" %s | %s |", ratio_text(rounds, i, e, &Timing::cpu).c_str(),
                  ratio_text(rounds, i, e, &Timing::wall).c_str());
    }
    std::printf("\n");
  }
}

Status run(const Options& options) {
  const Result<ModelFile> file = ModelFile::load(options.model);
  if (!file) return file.status();
  LCDM_RETURN_IF_ERROR(export_onnx(*file, options.width, options.height, options.onnx));
  std::signal(SIGPIPE, SIG_IGN);  // a peer that dies is an answer that does not come
  std::vector<Runner> runners;
  for (const Precision precision : kPrecisions) {
    LCDM_RETURN_IF_ERROR(add_engine(*file, options, precision, runners));
  }
  const std::size_t engines = runners.size();
  runners.push_back(libtorch_runner(*file, options));
  for (const std::string& peer : options.peers) runners.push_back(peer_runner(peer));

  std::vector<std::vector<Timing>> rounds;
  for (int r = 0; r <= options.rounds; ++r) {
    std::vector<Timing> round;
    for (const Runner& runner : runners) {
      const std::optional<Timing> timing = runner.run(options.frames);
      if (!timing) {
        return Status::error(StatusCode::kUnavailable,
                             "'%s' gave no answer in round %d: run it by hand and type 1",
                             runner.name.c_str(), r);
      }
      round.push_back(*timing);
      std::this_thread::sleep_for(kPause);
    }
    if (r > 0) rounds.push_back(round);  // the first warms up
  }
  std::printf("%s, %dx%d, %d thread(s), %d rounds of %d frames\n", file->config().name.c_str(),
              options.width, options.height, at::get_num_threads(), options.rounds, options.frames);
  print_table(runners, engines, rounds);
  return Status::ok();
}

}  // namespace

void add_compare(CLI::App& app, Status& status) {
  auto* command = app.add_subcommand(
      "compare", "Times the engine, LibTorch and other runtimes on the same network, interleaved");
  auto options = std::make_shared<Options>();
  command->add_option("--model", options->model, "Model file")
      ->required()
      ->check(CLI::ExistingFile);
  command->add_option("--peer", options->peers,
                      "Command that answers every line N with 'WALL CPU' of N frames; may be given "
                      "again (model/peers/)");
  command->add_option("--onnx", options->onnx, "Where the network is written for the peers")
      ->capture_default_str();
  command->add_option("--width", options->width, "Of the network's input")->capture_default_str();
  command->add_option("--height", options->height, "Of the network's input")->capture_default_str();
  command->add_option("--rounds", options->rounds, "Each times every runtime once")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--frames", options->frames, "Of a runtime in a round")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->callback([options, &status] { status = run(*options); });
}

}  // namespace lcdm::model
