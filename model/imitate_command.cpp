#include <cstdio>
#include <numeric>

#include "model/checkpoint.h"
#include "model/choice_option.h"
#include "model/commands.h"
#include "model/data_sets.h"
#include "model/encoder_imitation.h"
#include "model/recipe.h"
#include "model/safetensors.h"
#include "model/training_samples.h"

namespace lcdm::model {
namespace {

constexpr int kImages = 8;  // of a batch
constexpr const char* kMeterNotice =
    "; the encoder began as METER's (MIT, Copyright (c) 2022 lorenzopapa5)";

struct Options {
  std::string meter;
  std::string output;
  PixelScale pixels = kImagenetPixels;
  std::vector<int> size = {256, 192};
  std::int64_t steps = 160;
  std::uint64_t seed = 1;
  DataOptions data;
};

BatchShape shape_of(const Options& options) {
  BatchShape shape;
  shape.width = options.size[0];
  shape.height = options.size[1];
  shape.canonical_focal = kCanonicalFocal;
  shape.images = kImages;
  shape.wide = shape.width > 2 * shape.height;
  return shape;
}

void print(std::int64_t step, std::int64_t steps, const std::array<double, 5>& errors) {
  if (step % 20 != 0 && step + 1 != steps) return;
  std::printf("%lld/%lld  error of the taps", static_cast<long long>(step + 1),
              static_cast<long long>(steps));
  for (const double error : errors) std::printf(" %.3f", error);
  std::printf("\n");
  std::fflush(stdout);
}

Status run(const Options& options) {
  const Result<MeterEncoder> meter = read_meter_encoder(options.meter, options.pixels);
  if (!meter) return meter.status();
  const Result<Data> data = load_training_data(options.data);
  if (!data) return data.status();
  const BatchShape shape = shape_of(options);
  if (!is_drawn(data->packs, shape.wide)) {
    return Status::error(StatusCode::kInvalidInput,
                         "no picture of %dx%d: none of the sets has a %s-share", shape.width,
                         shape.height, shape.wide ? "wide" : "tall");
  }
  torch::manual_seed(options.seed);
  ModelConfig config;
  config.encoder = EncoderKind::kXxs;
  DepthNetwork network(config);
  start_as(*meter, network->encoder);
  BatchLoader loader(data->packs, {shape}, options.seed, 0, 2);
  LCDM_RETURN_IF_ERROR(imitate(*meter, network, loader, options.steps,
                               [&](std::int64_t step, const std::array<double, 5>& errors) {
                                 print(step, options.steps, errors);
                               }));
  TensorFile file;
  collect(*network->encoder, "", file.tensors);
  file.metadata["licence"] = data->licence + kMeterNotice;
  LCDM_RETURN_IF_ERROR(write_tensors(options.output, file));
  std::printf("%s: %zu tensors, for train --encoder-weights\n", options.output.c_str(),
              file.tensors.size());
  return Status::ok();
}

}  // namespace

void add_imitate(CLI::App& app, Status& status) {
  auto* command = app.add_subcommand(
      "imitate", "Teaches an XXS encoder what METER's gives, to start a training from");
  auto options = std::make_shared<Options>();
  command->add_option("--meter", options->meter, "METER-XXS as its authors' ONNX file")
      ->check(CLI::ExistingFile)
      ->required();
  command->add_option("--output", options->output, "The .safetensors file to write")->required();
  add_choice(*command, "--pixels", options->pixels, pixel_scale_names(),
             "How METER's pictures are scaled: imagenet (mean and deviation; the default, trained "
             "on NYU) or unit ([0, 1]; on KITTI)");
  command
      ->add_option("--size", options->size,
                   "Width and height both are fed, multiples of 64: what METER was trained at")
      ->expected(2)
      ->check(CLI::Range(64, 2048) & CLI::Validator(
                                         [](std::string& text) {
                                           return std::stoi(text) % 64 == 0
                                                      ? std::string()
                                                      : text + " is no multiple of 64";
                                         },
                                         ""))
      ->capture_default_str();
  command->add_option("--steps", options->steps, "Of eight pictures")
      ->check(CLI::Range(1, 1000000))
      ->capture_default_str();
  command->add_option("--seed", options->seed, "Of weights and pictures")->capture_default_str();
  add_data_options(*command, options->data);
  command->callback([options, &status] { status = run(*options); });
}

}  // namespace lcdm::model
