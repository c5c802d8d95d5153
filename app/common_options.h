// The options that several commands share, and what they lead to.
#pragma once

#include <CLI/CLI.hpp>
#include <string>
#include <utility>
#include <vector>

#include "app/config.h"
#include "app/recorder.h"
#include "app/source.h"
#include "firmware/base/status.h"
#include "firmware/nn/engine.h"
#include "firmware/pipeline/camera.h"

namespace lcdm {

// What a command's own options say of the configuration: `option` overrides `key` where `value` is
// not empty.
class Overrides {
 public:
  Overrides& add(const char* key, const char* option, const std::string& value);
  std::vector<ConfigAssignment> take() { return std::move(assignments_); }

 private:
  std::vector<ConfigAssignment> assignments_;
};

// --config, --set and --model. Lives as long as the command line is parsed and its command runs.
struct CommonOptions {
  std::string config_file;
  std::vector<std::string> assignments;
  std::string model;

  void add_to(CLI::App& command);        // --config and --set
  void add_model_to(CLI::App& command);  // --model, where one is used
  // Defaults, file, environment, --set, then `more` and --model: later ones win.
  Result<Config> load(std::vector<ConfigAssignment> more = {}) const;
};

// The released model beside the program: in this checkout, or installed. Empty when there is none.
std::string find_default_model();

// Reads the configured model, or the default one. The text of an error names the file.
Result<ModelFile> load_model(const Config& config);

EngineOptions engine_options(const Config& config);
CaptureRequest capture_request(const Config& config);
// `auto` becomes the first camera that delivers; how it was found is printed. kNotFound: none does.
Status settle_source(Config& config);
// As settle_source, but where there is no camera the rendered scene is shown.
void settle_source_or_scene(Config& config);
// The source of `uri`, with the configured calibration. kInvalidInput also: the calibration's file.
Result<OpenedSource> open_source(const Config& config, const std::string& uri, Playback playback);
RecorderOptions recorder_options(const Config& config);

}  // namespace lcdm
