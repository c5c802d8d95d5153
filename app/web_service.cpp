#include "app/web_service.h"

#include <array>
#include <chrono>
#include <cstdio>
#include <span>
#include <string>

#include "app/control.h"
#include "app/json_text.h"
#include "app/no_signal.h"
#include "app/status_json.h"
#include "app/web_files.h"
#include "firmware/base/os.h"

namespace lcdm {
namespace {

using std::chrono::milliseconds;
using Wait = LiveView::Wait;

// How long a request for one picture waits for the next frame.
constexpr milliseconds kPictureWait{3000};
// A viewer hears from us at least this often, frames or not.
constexpr milliseconds kSignOfLife{1000};
// A picture that old is frozen, also where depth comes: nobody encodes it any more.
constexpr std::int64_t kFrozenNs = 10'000'000'000;
// Without a look of main's at everything for this long, its judgement counts no more.
constexpr std::int64_t kLookDeadlineNs = 10'000'000'000;

constexpr const char* kJson = "application/json";
constexpr const char* kText = "text/plain; charset=utf-8";

struct Parts {
  const Pipeline& pipeline;
  LiveView& view;
  Recorder& recorder;
  const Service& service;
  std::int64_t started_ns;

  nlohmann::json status(const HttpExchange& exchange) const {
    return status_json(pipeline, recorder.status(), service.status(), exchange.viewers(),
                       started_ns);
  }
};
using PartsPtr = std::shared_ptr<const Parts>;

HttpRoute file_route(const std::string& path, const std::string& name, const std::string& type) {
  return {path, "GET", HttpStay::kShort,
          [name, type](HttpExchange& exchange) { exchange.send(200, type, find_web_file(name)); }};
}

void send_health(const Parts& parts, HttpExchange& exchange) {
  const ServiceStatus now = parts.service.status();
  const bool hangs = now.looked_ns > 0 && os::monotonic_ns() - now.looked_ns > kLookDeadlineNs;
  const DeviceState state = now.judgement.state;
  const bool well = gives_depth(state) && !hangs;
  exchange.send_text(well ? 200 : 503, kText,
                     std::string(hangs ? "thread main hangs" : to_string(state)) + "\n");
}

// In milliseconds.
std::string age_text(std::int64_t age_ns) {
  char text[32];
  std::snprintf(text, sizeof(text), "%.1f", static_cast<double>(age_ns) * 1e-6);
  return text;
}

// Everything that one must know to use the depth rightly, as headers.
HttpHeaders depth_headers(const ProductCopy& product) {
  return {{"X-Depth-Scale", to_string(product.scale)},
          {"X-Depth-Unit", "millimetre"},
          {"X-Frame-Sequence", std::to_string(product.meta.sequence)},
          {"X-Frame-Stamp", std::to_string(product.meta.unix_ns)},
          {"X-Frame-Age", age_text(os::monotonic_ns() - product.meta.sensor_ns)}};
}

// Of the newest depth; negative: there was none yet.
std::int64_t frame_age_ns(const Parts& parts) {
  return parts.pipeline.health().snapshot(os::monotonic_ns()).frame_age_ns;
}

void begin_recording(const Parts& parts, HttpExchange& exchange) {
  if (const Status status = start_recording(parts.pipeline, parts.recorder); !status) {
    exchange.send_text(status.code() == StatusCode::kUnavailable ? 503 : 500, kText,
                       std::string(status.text()) + "\n");
    return;
  }
  exchange.send_text(200, kJson, json_text(parts.status(exchange)["recording"]));
}

void end_recording(const Parts& parts, HttpExchange& exchange) {
  parts.recorder.stop();
  exchange.send_text(200, kJson, json_text(parts.status(exchange)["recording"]));
}

void send_depth_png(const Parts& parts, HttpExchange& exchange) {
  LiveView::Subscription subscription(parts.view, Product::kDepthPng);
  ProductCopy product;
  if (subscription.wait_newer(parts.view.newest(), kPictureWait, product) != Wait::kNewer) {
    const std::int64_t age_ns = frame_age_ns(parts);
    HttpHeaders headers = {{"Retry-After", "1"}};
    if (age_ns >= 0) headers.emplace_back("X-Frame-Age", age_text(age_ns));
    exchange.send_text(503, kText, no_signal_text(age_ns) + ": " + parts.pipeline.fault() + "\n",
                       headers);
    return;
  }
  exchange.send(200, "image/png", product.bytes, depth_headers(product));
}

bool write_part(HttpExchange& exchange, std::span<const std::byte> jpeg,
                const HttpHeaders& headers) {
  std::string head =
      "--frame\r\nContent-Type: image/jpeg\r\nContent-Length: " + std::to_string(jpeg.size()) +
      "\r\n";
  for (const auto& [name, value] : headers) {
    head.append(name).append(": ").append(value).append("\r\n");
  }
  return exchange.write_text(head + "\r\n") && exchange.write(jpeg) && exchange.write_text("\r\n");
}

// In place of `last`, which would look live: the same without colours, saying how old it is.
bool write_no_signal(const Parts& parts, HttpExchange& exchange, const ProductCopy& last) {
  const std::int64_t age_ns =
      last.bytes.empty() ? frame_age_ns(parts) : os::monotonic_ns() - last.meta.sensor_ns;
  const bool slow =
      parts.pipeline.health().state() == PipelineState::kStreaming && age_ns < kFrozenNs;
  if (slow) return exchange.write_text("\r\n");  // notices when the viewer has gone
  HttpHeaders headers;
  if (age_ns >= 0) headers.emplace_back("X-Frame-Age", age_text(age_ns));
  return write_part(exchange, no_signal_jpeg(last.bytes, age_ns), headers);
}

void stream_mjpeg(const Parts& parts, HttpExchange& exchange) {
  const std::string wanted = exchange.query("view");
  if (!wanted.empty() && wanted != "colour" && wanted != "depth") {
    exchange.send_text(400, kText, "view is colour or depth, or left out for both\n");
    return;
  }
  const Product kind = wanted == "colour"  ? Product::kColourJpeg
                       : wanted == "depth" ? Product::kDepthJpeg
                                           : Product::kSideJpeg;
  LiveView::Subscription subscription(parts.view, kind);
  if (!exchange.begin_stream("multipart/x-mixed-replace; boundary=frame")) return;
  ProductCopy product;
  product.number = parts.view.newest();
  bool open = true;
  while (open) {
    const Wait wait = subscription.wait_newer(product.number, kSignOfLife, product);
    if (wait == Wait::kClosed) return;
    if (wait == Wait::kTimeout) {
      open = write_no_signal(parts, exchange, product);
    } else {
      open = write_part(exchange, product.bytes, depth_headers(product));
    }
  }
}

std::array<std::byte, 16> live_head(std::size_t json, std::size_t jpeg, std::size_t depth) {
  std::array<std::byte, 16> head{std::byte{'L'}, std::byte{'C'}, std::byte{'D'}, std::byte{'M'}};
  std::size_t at = 4;
  for (const std::size_t value : {json, jpeg, depth}) {
    for (int shift = 0; shift < 32; shift += 8) head[at++] = static_cast<std::byte>(value >> shift);
  }
  return head;
}

// The page's stream (web/live.js reads it): status, colour and depth of the same frame.
void stream_live(const Parts& parts, HttpExchange& exchange) {
  LiveView::Subscription subscription(parts.view, Product::kLive);
  if (!exchange.begin_stream("application/octet-stream")) return;
  ProductCopy product;
  product.number = parts.view.newest();
  bool open = true;
  while (open) {
    const Wait wait = subscription.wait_newer(product.number, kSignOfLife, product);
    if (wait == Wait::kClosed) return;
    const bool came = wait == Wait::kNewer;
    nlohmann::json status = parts.status(exchange);
    if (came) {
      status["picture"] = {{"sequence", product.meta.sequence},
                           {"width", product.camera.width},
                           {"height", product.camera.height}};
    }
    const std::string json = json_text(status);
    const std::size_t jpeg = came ? product.picture_bytes : 0;
    const std::size_t depth = came ? product.bytes.size() - jpeg : 0;
    open = exchange.write(live_head(json.size(), jpeg, depth)) && exchange.write_text(json) &&
           (!came || exchange.write(product.bytes));
  }
}

}  // namespace

std::vector<HttpRoute> web_routes(const Pipeline& pipeline, LiveView& view, Recorder& recorder,
                                  const Service& service) {
  const PartsPtr parts =
      std::make_shared<const Parts>(Parts{pipeline, view, recorder, service, os::monotonic_ns()});
  const auto route = [&](const char* path, HttpStay stay, auto handler) {
    return HttpRoute{path, "GET", stay,
                     [parts, handler](HttpExchange& exchange) { handler(*parts, exchange); }};
  };
  const auto action = [&](const char* path, auto handler) {
    // The disk may let the recorder wait.
    return HttpRoute{path, "POST", HttpStay::kWaits,
                     [parts, handler](HttpExchange& exchange) { handler(*parts, exchange); }};
  };
  return {
      file_route("/", "index.html", "text/html; charset=utf-8"),
      file_route("/style.css", "style.css", "text/css; charset=utf-8"),
      file_route("/page.js", "page.js", "text/javascript; charset=utf-8"),
      file_route("/live.js", "live.js", "text/javascript; charset=utf-8"),
      file_route("/depth.js", "depth.js", "text/javascript; charset=utf-8"),
      file_route("/icon.svg", "icon.svg", "image/svg+xml"),
      route("/live", HttpStay::kStream, stream_live),
      route("/stream.mjpg", HttpStay::kStream, stream_mjpeg),
      route("/depth.png", HttpStay::kWaits, send_depth_png),
      route("/status.json", HttpStay::kShort,
            [](const Parts& p, HttpExchange& exchange) {
              exchange.send_text(200, kJson, json_text(p.status(exchange)));
            }),
      route("/healthz", HttpStay::kShort, send_health),
      action("/record/start", begin_recording),
      action("/record/stop", end_recording),
  };
}

}  // namespace lcdm
