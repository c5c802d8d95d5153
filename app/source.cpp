#include "app/source.h"

#include <charconv>
#include <chrono>
#include <cstdint>
#include <optional>
#include <string_view>
#include <vector>

#ifdef LCDM_LIBCAMERA
#include "drivers/libcamera/camera.h"
#endif
#include "drivers/mcap_camera.h"
#include "drivers/replay/camera.h"
#include "drivers/scene/camera.h"
#include "drivers/usb_port.h"
#include "drivers/v4l2/camera.h"
#include "drivers/v4l2/nodes.h"
#include "firmware/base/os.h"

namespace lcdm {
namespace {

constexpr std::chrono::seconds kTrial{3};
constexpr std::uint64_t kDefaultSeed = 1;

// The seed behind `scene:`; empty when it is no number.
std::optional<std::uint64_t> parse_seed(const std::string& text) {
  if (text.empty()) return kDefaultSeed;
  std::uint64_t seed = 0;
  const auto parsed = std::from_chars(text.data(), text.data() + text.size(), seed);
  if (parsed.ec != std::errc() || parsed.ptr != text.data() + text.size()) return std::nullopt;
  return seed;
}

// Dequeues until a frame came, or for kTrial.
Status wait_for_frame(Camera& camera) {
  const std::int64_t end = os::monotonic_ns() + std::chrono::nanoseconds(kTrial).count();
  while (true) {
    const auto frame = camera.dequeue(std::chrono::milliseconds(250));
    if (frame) return camera.requeue(frame->index);
    const bool transient =
        frame.code() == StatusCode::kTimeout || frame.code() == StatusCode::kCorrupt;
    if (!transient || os::monotonic_ns() > end) return frame.status();
  }
}

Status try_camera(Camera& camera, const CaptureRequest& request) {
  LCDM_RETURN_IF_ERROR(camera.configure(request));
  Status status = camera.start();
  if (status) status = wait_for_frame(camera);
  camera.stop();
  return status;
}

Result<OpenedSource> open_libcamera(const std::string& id) {
#ifdef LCDM_LIBCAMERA
  return OpenedSource{std::make_unique<LibcameraCamera>(id), false, true,
                      std::make_unique<UsbPort>()};
#else
  return Status::error(StatusCode::kUnsupported,
                       "libcamera:%s: this lcdm was built without libcamera: install libcamera-dev "
                       "0.0.3 or newer and build again, or use v4l2:",
                       id.c_str());
#endif
}

}  // namespace

std::optional<std::string> after_scheme(const std::string& uri, std::string_view scheme) {
  if (uri.rfind(scheme, 0) != 0) return std::nullopt;
  return uri.substr(scheme.size());
}

bool is_source_uri(const std::string& text) {
  for (const char* scheme : {"file:", "mcap:", "v4l2:", "libcamera:"}) {
    if (const auto rest = after_scheme(text, scheme)) return !rest->empty();
  }
  const auto seed = after_scheme(text, "scene:");
  return seed && parse_seed(*seed).has_value();
}

Result<OpenedSource> open_source(const std::string& uri, Playback playback) {
  const bool live = playback == Playback::kLive;
  if (const auto path = after_scheme(uri, "file:")) {
    const auto how = live ? ReplayCamera::Playback::kLive : ReplayCamera::Playback::kOffline;
    return OpenedSource{std::make_unique<ReplayCamera>(*path, how), false, live};
  }
  if (const auto path = after_scheme(uri, "mcap:")) {
    const auto how = live ? McapCamera::Playback::kLive : McapCamera::Playback::kOffline;
    return OpenedSource{std::make_unique<McapCamera>(*path, how), false, live};
  }
  if (const auto device = after_scheme(uri, "v4l2:")) {
    return OpenedSource{std::make_unique<V4l2Camera>(*device), true, true,
                        std::make_unique<UsbPort>()};
  }
  if (const auto id = after_scheme(uri, "libcamera:")) {
    return open_libcamera(*id);
  }
  if (const auto text = after_scheme(uri, "scene:")) {
    if (const auto seed = parse_seed(*text)) {
      return OpenedSource{std::make_unique<SceneCamera>(*seed), true, true};
    }
  }
  return Status::error(StatusCode::kUsage, "%.80s: no such source: use %s", uri.c_str(),
                       kSourceForms);
}

Result<std::string> find_camera(const CaptureRequest& request, std::string& rejected) {
  rejected.clear();
  const auto reject = [&rejected](const std::string& reason) {
    rejected += (rejected.empty() ? "" : "; ") + reason;
  };
  for (const V4l2Node& node : list_v4l2_nodes()) {
    if (!node.usable) {
      reject(node.reason);
      continue;
    }
    V4l2Camera camera(node.path);
    const Status status = try_camera(camera, request);
    if (status) return "v4l2:" + node.path;
    reject(status.text());
  }
  if (rejected.empty()) {
    return Status::error(StatusCode::kNotFound, "no camera found (no /dev/video*)");
  }
  return Status::error(StatusCode::kNotFound, "no usable camera: %s", rejected.c_str());
}

}  // namespace lcdm
