// From a source's URI to its camera.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "firmware/base/status.h"
#include "firmware/pipeline/camera.h"
#include "firmware/pipeline/camera_port.h"

namespace lcdm {

// Live: at the source's own pace, for ever where it can. Offline: each frame once, at its own size.
enum class Playback { kLive, kOffline };

struct OpenedSource {
  std::unique_ptr<Camera> camera;  // not configured yet
  bool seal_capture = false;       // its capture thread keeps the promise not to allocate
  bool endless = false;            // gives frames until it is stopped, offline too
  // Where it is plugged in; null: it is nothing that comes and goes.
  std::unique_ptr<CameraPort> port{};
};

// The forms a source may have, for messages.
constexpr const char* kSourceForms =
    "scene:, file:PATH, mcap:PATH, v4l2:/dev/..., v4l2:any, v4l2:serial=TEXT, v4l2:name=TEXT or "
    "libcamera:ID";

// Whether the text has the form of a source: a scheme we know and what it needs. Does not look
// whether anything is there.
bool is_source_uri(const std::string& text);

// What stands behind `scheme` ("v4l2:"), where the text begins with that.
std::optional<std::string> after_scheme(const std::string& uri, std::string_view scheme);

// kUsage: not the form of a source, which the configuration's always has.
Result<OpenedSource> open_source(const std::string& uri, Playback playback);

// The source of the first V4L2 node that delivers a frame within 3 s. `rejected` says why those
// before it, if any, do not. kNotFound: there is none, with every node's reason.
Result<std::string> find_camera(const CaptureRequest& request, std::string& rejected);

}  // namespace lcdm
