// lcdm run: the camera service. Source -> pipeline -> page.
#include <algorithm>
#include <cstdio>
#include <memory>
#include <optional>
#include <string>

#include "app/commands/commands.h"
#include "app/common_options.h"
#include "app/engine_factory.h"
#include "app/http_token.h"
#include "app/live_view.h"
#include "app/mjpeg_decoder.h"
#include "app/page.h"
#include "app/recorder.h"
#include "app/report.h"
#include "app/service.h"
#include "app/source.h"
#include "app/stop_signals.h"
#include "app/web_service.h"
#include "firmware/base/exit_code.h"
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
  return options.common.load(Overrides()
                                 .add("camera.source", "--source", options.source)
                                 .add("http.listen", "--listen", options.listen)
                                 .add("http.port", "--port", options.port)
                                 .take());
}

Result<HttpOptions> http_options(const Config& config) {
  HttpOptions http;
  http.listen = listen_addresses(config.http.listen);
  http.port = config.http.port;
  http.max_clients = config.http.max_clients;
  http.insecure = config.http.insecure;
  if (config.http.token_file.empty()) return http;
  const Result<std::string> token = read_token(config.http.token_file);
  if (!token) return token.status();
  http.token = *token;
  return http;
}

int run(const RunOptions& options) {
  const StopSignals signals;
  Result<Config> config = load(options);
  if (!config) return report(config.status());
  Result<ModelFile> model = load_model(*config);
  if (!model) return report(model.status());

  const Result<HttpOptions> http = http_options(*config);
  if (!http) return report(http.status());

  settle_source_or_scene(*config);
  Result<OpenedSource> source = open_source(*config, config->camera.source, Playback::kLive);
  if (!source) return report(source.status());

  MjpegDecoder decoder;
  LiveView view(config->camera.source);
  Recorder recorder(recorder_options(*config));
  PipelineOptions pipeline_options;
  pipeline_options.request = capture_request(*config);
  pipeline_options.seal_capture = source->seal_capture;
  pipeline_options.port = source->port.get();
  const EngineFactories factories = engine_factories(*config, std::move(*model));
  Pipeline pipeline(*source->camera, factories.full, &decoder, {&view, &recorder}, pipeline_options,
                    factories.small);
  Service service(pipeline, view, recorder, *config);

  // The port before the pipeline: what cannot be shown need not start.
  const auto page = Page::start(*http, web_routes(pipeline, view, recorder, service));
  if (!page) return report(page.status());
  service.watch_page((*page)->heartbeat());

  Status status = service.start(signals);
  if (status) {
    const std::string address = (*page)->address();
    if (!address.empty()) std::printf("page    %s\n", address.c_str());
    std::fflush(stdout);
    status = service.run(signals);
  }
  view.stop();
  (*page)->stop();
  recorder.stop();  // before the pipeline, which a driver may hold: the file is whole
  const int exit_code = status ? kExitOk : report(status);
  service.end(exit_code);
  return exit_code;
}

}  // namespace

void add_run_command(CLI::App& program, int& exit_code) {
  auto options = std::make_shared<RunOptions>();
  CLI::App* command = program.add_subcommand(
      "run", "The camera service: depth of a live source, shown on a page in the browser");
  command
      ->add_option("--source", options->source,
                   std::string("auto, ") + kSourceForms + " (default: camera.source)")
      ->type_name("URI");
  command->add_option("--listen", options->listen, "Addresses of the page (default: http.listen)")
      ->type_name("ADDR");
  command->add_option("--port", options->port, "Port of the page (default: http.port)")
      ->type_name("N");
  options->common.add_to(*command);
  options->common.add_model_to(*command);
  command->callback([options, &exit_code] { exit_code = run(*options); });
}

}  // namespace lcdm
