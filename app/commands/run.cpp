// lcdm run: the camera service. Source -> pipeline -> page.
#include <algorithm>
#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "app/commands/commands.h"
#include "app/common_options.h"
#include "app/exit_code.h"
#include "app/http_server.h"
#include "app/live_view.h"
#include "app/mjpeg_decoder.h"
#include "app/recorder.h"
#include "app/report.h"
#include "app/service.h"
#include "app/source.h"
#include "app/stop_signals.h"
#include "app/web_service.h"
#include "firmware/pipeline/pipeline.h"

namespace lcdm {
namespace {

struct RunOptions {
  CommonOptions common;
  std::string source;
  std::string listen;
  std::string port;
};

Result<Config> load(const RunOptions& options) {
  std::vector<ConfigAssignment> more;
  const auto add = [&more](const char* key, const char* option, const std::string& value) {
    if (!value.empty()) more.push_back({key + ("=" + value), option + (" " + value)});
  };
  add("camera.source", "--source", options.source);
  add("http.listen", "--listen", options.listen);
  add("http.port", "--port", options.port);
  return options.common.load(std::move(more));
}

// The first engine is made from the file that was already read and checked; later ones, for a
// camera that came back different, read it again, so that it need not stay in memory.
Pipeline::EngineFactory engine_factory(const Config& config, ModelFile first) {
  auto kept = std::make_shared<std::optional<ModelFile>>(std::move(first));
  return [config, kept](const FrameFormat& format,
                        const CameraModel& model) -> Result<std::unique_ptr<Engine>> {
    if (*kept) {
      auto engine = Engine::prepare(**kept, engine_options(config), format, model);
      kept->reset();
      return engine;
    }
    const Result<ModelFile> file = load_model(config);
    if (!file) return file.status();
    return Engine::prepare(*file, engine_options(config), format, model);
  };
}

int run(const RunOptions& options) {
  const StopSignals signals;
  Result<Config> config = load(options);
  if (!config) return report_unusable(config.status());
  Result<ModelFile> model = load_model(*config);
  if (!model) return report_unusable(model.status());

  if (config->camera.source == "auto") {
    config->camera.source = choose_source(capture_request(*config), [](const std::string& line) {
      std::printf("%s\n", line.c_str());
      std::fflush(stdout);
    });
  }
  Result<OpenedSource> source = open_source(config->camera.source, Playback::kLive);
  if (!source) return report_failure(source.status());

  MjpegDecoder decoder;
  LiveView view(config->camera.source);
  Recorder recorder(recorder_options(*config));
  PipelineOptions pipeline_options;
  pipeline_options.request = capture_request(*config);
  pipeline_options.seal_capture = source->seal_capture;
  Pipeline pipeline(*source->camera, engine_factory(*config, std::move(*model)), &decoder,
                    {&view, &recorder}, pipeline_options);
  Service service(pipeline, view, recorder);

  // The port before the pipeline: what cannot be shown need not start.
  HttpOptions http;
  http.listen = config->http.listen;
  http.port = config->http.port;
  http.max_clients = config->http.max_clients;
  const auto server = HttpServer::start(http, web_routes(pipeline, view, recorder, service));
  if (!server) return report_failure(server.status());

  const Status started = pipeline.start();
  if (started) {
    std::printf("page    %s\n", (*server)->address().c_str());
    std::fflush(stdout);
    service.run(signals);
  }
  view.stop();
  (*server)->stop();
  pipeline.stop();
  recorder.stop();
  return started ? kExitOk : report_failure(started);
}

}  // namespace

void add_run_command(CLI::App& program, int& exit_code) {
  auto options = std::make_shared<RunOptions>();
  CLI::App* command = program.add_subcommand(
      "run", "The camera service: depth of a live source, shown on a page in the browser");
  command
      ->add_option("--source", options->source,
                   "auto, v4l2:/dev/..., scene:, file:PATH or mcap:PATH (default: auto)")
      ->type_name("URI");
  command->add_option("--listen", options->listen, "Address of the page (default: 127.0.0.1)")
      ->type_name("ADDR");
  command->add_option("--port", options->port, "Port of the page (default: 8080)")->type_name("N");
  options->common.add_to(*command);
  command->callback([options, &exit_code] { exit_code = run(*options); });
}

}  // namespace lcdm
