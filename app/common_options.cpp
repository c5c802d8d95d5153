#include "app/common_options.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <system_error>
#include <utility>

#include "app/calibrated_camera.h"
#include "firmware/base/os.h"

namespace lcdm {
namespace {

// More threads than processors only wait for each other.
void fit_threads(Config& config) {
  const int processors = os::processor_count();
  if (config.model.threads <= processors) return;
  std::fprintf(stderr,
               "warning: model.threads = %d, but this program may use %d processor%s: as many "
               "threads are used\n",
               config.model.threads, processors, processors == 1 ? "" : "s");
  config.model.threads = processors;
}

}  // namespace

Overrides& Overrides::add(const char* key, const char* option, const std::string& value) {
  const std::string given = std::string(option) + " " + value;
  if (!value.empty()) assignments_.push_back({std::string(key) + "=" + value, given});
  return *this;
}

void CommonOptions::add_to(CLI::App& command) {
  command.add_option("--config", config_file, "Configuration file (default: /etc/lcdm/lcdm.toml)")
      ->type_name("FILE");
  command.add_option("--set", assignments, "One value, as section.key=value; may be repeated")
      ->type_name("KEY=VALUE")
      ->allow_extra_args(false);
}

void CommonOptions::add_model_to(CLI::App& command) {
  command.add_option("--model", model, "Weights (default: the released ones)")->type_name("FILE");
}

Result<Config> CommonOptions::load(std::vector<ConfigAssignment> more) const {
  ConfigSources sources;
  sources.file = config_file.empty() ? default_config_file() : config_file;
  sources.environment = process_environment();
  for (const std::string& text : assignments)
    sources.assignments.push_back({text, "--set " + text});
  for (ConfigAssignment& assignment : more) sources.assignments.push_back(std::move(assignment));
  if (!model.empty()) sources.assignments.push_back({"model.file=" + model, "--model " + model});
  Result<Config> config = load_config(sources);
  if (config) fit_threads(*config);
  return config;
}

std::string find_default_model() {
  // The better one first (model/weights/README.md).
  namespace fs = std::filesystem;
  std::error_code error;
  // The program lies in build/PRESET/bin of a checkout, or is installed.
  const fs::path program = fs::read_symlink("/proc/self/exe", error).parent_path();
  const std::array<fs::path, 2> folders = {program / "../../../model/weights", "/usr/share/lcdm"};
  for (const fs::path& folder : folders) {
    for (const char* name : {"lcdm-xs.safetensors", "lcdm-xxs.safetensors"}) {
      const fs::path file = fs::weakly_canonical(folder / name, error);
      if (fs::is_regular_file(file, error)) return file.string();
    }
  }
  return {};
}

Result<ModelFile> load_model(const Config& config) {
  const std::string file = config.model.file.empty() ? find_default_model() : config.model.file;
  if (file.empty()) {
    return Status::error(
        StatusCode::kInvalidInput,
        "no model found in the clone the program was built in or in /usr/share/lcdm: give one with "
        "--model FILE or model.file");
  }
  return ModelFile::load(file);
}

EngineOptions engine_options(const Config& config) {
  EngineOptions options;
  options.precision = parse_precision(config.model.precision).value_or(options.precision);
  options.pin_threads = config.model.pin_threads;
  options.width = config.model.width;
  options.height = config.model.height;
  options.threads = config.model.threads > 0
                        ? config.model.threads
                        : std::clamp(os::processor_count() - 1, 1, EngineOptions::kMaxThreads);
  return options;
}

CaptureRequest capture_request(const Config& config) {
  CaptureRequest request;
  request.width = config.camera.width;
  request.height = config.camera.height;
  request.frames_per_second = static_cast<float>(config.camera.frames_per_second);
  request.assumed_field_of_view = static_cast<float>(config.camera.field_of_view);
  request.controls = {config.camera.exposure_ms, config.camera.gain,
                      config.camera.white_balance_kelvin, config.camera.power_line_hz};
  request.format = parse_pixel_format(config.camera.format);
  return request;
}

Status settle_source(Config& config) {
  if (config.camera.source != "auto") return Status::ok();
  std::string rejected;
  const Result<std::string> found = find_camera(capture_request(config), rejected);
  if (!found) {
    return Status::error(found.code(), "%s: plug one in, or name another source (--source)",
                         found.status().text());
  }
  if (!rejected.empty()) std::printf("rejected: %s\n", rejected.c_str());
  std::fflush(stdout);
  config.camera.source = *found;
  return Status::ok();
}

void settle_source_or_scene(Config& config) {
  const Status found = settle_source(config);
  if (found) return;
  std::printf("%s; showing the rendered scene\n", found.text());
  std::fflush(stdout);
  config.camera.source = "scene:";
}

Result<OpenedSource> open_source(const Config& config, const std::string& uri, Playback playback) {
  Result<OpenedSource> source = open_source(uri, playback);
  if (!source || config.camera.calibration.empty()) return source;
  Result<Calibration> calibration = read_calibration(config.camera.calibration);
  if (!calibration) return calibration.status();
  source->camera = std::make_unique<CalibratedCamera>(
      std::move(source->camera), std::move(*calibration), source->port != nullptr);
  return source;
}

RecorderOptions recorder_options(const Config& config) {
  RecorderOptions options;
  options.directory = config.record.directory;
  options.segment_bytes = std::int64_t{config.record.segment_megabytes} << 20;
  options.keep_free_bytes = std::int64_t{config.record.keep_free_megabytes} << 20;
  return options;
}

}  // namespace lcdm
