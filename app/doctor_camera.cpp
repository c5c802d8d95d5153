#include "app/doctor_camera.h"

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <system_error>
#include <unistd.h>

#include "app/common_options.h"
#include "app/doctor_rate.h"
#include "app/source.h"
#ifdef LCDM_LIBCAMERA
#include "drivers/libcamera/camera.h"
#endif
#include "drivers/v4l2/device.h"

namespace lcdm {
namespace {

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof(text), "%g", value);
  return text;
}

bool is_camera_source(const std::string& source) {
  return source == "auto" || after_scheme(source, "v4l2:") || after_scheme(source, "libcamera:");
}

// A camera on a slower bus than it could use: no rate, or only compressed frames.
Finding check_bus(const V4l2Node& node) {
  const std::string name = node.path + " (" + node.card + ")";
  if (node.usb_mbps == 0) return well("camera", name + ": not on USB, driver " + node.driver);
  const std::string speed =
      name + ": USB at " + number(static_cast<double>(node.usb_mbps)) + " Mb/s";
  if (node.usb_mbps < 480) {
    return warning("camera", speed + ", too slow for video: use a USB 2 or 3 port and cable");
  }
  if (node.usb_version >= 3 && node.usb_mbps < 5000) {
    return warning("camera", speed + ", though it is made for USB " +
                                 number(static_cast<double>(node.usb_version)) +
                                 ": use a blue port and a USB 3 cable");
  }
  return well("camera", speed);
}

// The service may have fewer rights than who calls, root above all, and it may have more.
Finding check_node(const V4l2Node& node, const Account& account) {
  if (!account.is_caller && !account.may(node.path, R_OK | W_OK)) {
    return fault("camera", node.path + ": " + account.name +
                               " may not open it: SupplementaryGroups=video in the unit");
  }
  if (!account.is_caller && access(node.path.c_str(), R_OK | W_OK) != 0 && errno == EACCES) {
    return well("camera", node.path + ": " + account.name +
                              " may open it, this user not: `sudo lcdm doctor` says more");
  }
  return node.usable ? check_bus(node) : warning("camera", node.reason);
}

// Without this the recovery ladder lacks a rung.
Finding check_port_reset(const V4l2Node& node, const Account& account) {
  if (account.may(node.usb, W_OK)) {
    return well("reset", node.usb + " may be reset by " + account.name);
  }
  return warning("reset", node.usb + ": " + account.name +
                              " may not reset it when the camera hangs: give the group video "
                              "write permission (a udev rule)");
}

// The node that the configuration's source means now; empty: none.
std::string configured_node(const std::string& source, const std::vector<V4l2Node>& nodes) {
  if (const auto selector = after_scheme(source, "v4l2:")) {
    const Result<std::string> found = find_v4l2_node(*selector);
    return found ? *found : "";
  }
  if (source != "auto") return "";
  const auto first =
      std::find_if(nodes.begin(), nodes.end(), [](const V4l2Node& node) { return node.usable; });
  return first == nodes.end() ? "" : first->path;
}

std::vector<std::string> libcamera_cameras() {
#ifdef LCDM_LIBCAMERA
  return list_libcamera_cameras();
#else
  return {};
#endif
}

// A source that is no camera: its files must be there.
Finding check_replayed(const std::string& source) {
  const auto video = after_scheme(source, "file:");
  const auto path = video ? video : after_scheme(source, "mcap:");
  std::error_code error;
  if (path && !std::filesystem::exists(*path, error)) {
    return fault("camera", source + ": there is no such file or folder: set camera.source");
  }
  return well("camera", source + ": needs none");
}

// What really comes from the camera: by a trial, or by the counters of the lcdm that holds it.
Finding try_camera(const std::string& uri, const Config& config) {
  const CaptureRequest request = capture_request(config);
  const Result<OpenedSource> source = open_source(uri, Playback::kLive);
  if (!source) return fault("rate", source.status().text());
  Camera& camera = *source->camera;
  const Result<float> measured = measure_rate(camera, request);
  const bool held = measured.status().sys_errno() == EBUSY;
  const float promised = camera.info().frames_per_second;
  return check_arrivals(
      held ? served_rate(config, uri) : measured,
      promised > 0 ? std::min(promised, request.frames_per_second) : request.frames_per_second);
}

}  // namespace

std::vector<Finding> check_cameras(const std::vector<V4l2Node>& nodes, const std::string& source,
                                   const Account& account) {
  std::vector<Finding> findings;
  const bool usable =
      std::any_of(nodes.begin(), nodes.end(), [](const V4l2Node& node) { return node.usable; });
  for (const V4l2Node& node : nodes) {
    if (usable && !node.usable) continue;  // beside a camera that works its metadata is no news
    findings.push_back(check_node(node, account));
    if (node.usable && !node.usb.empty()) findings.push_back(check_port_reset(node, account));
  }
  if (const auto selector = after_scheme(source, "v4l2:")) {
    const Result<std::string> node = find_v4l2_node(*selector);
    V4l2Device device;
    const Status opened = node ? device.open(*node) : node.status();
    const bool closed_to_us_alone = !account.is_caller && opened.sys_errno() == EACCES;
    if (!opened && !closed_to_us_alone) findings.push_back(fault("camera", opened.text()));
  } else if (source == "auto" && !usable) {
    findings.push_back(
        warning("camera", "auto finds none and shows the rendered scene: plug one in"));
  } else if (!is_camera_source(source)) {
    findings.push_back(check_replayed(source));
  } else if (after_scheme(source, "libcamera:")) {
    findings.push_back(check_libcamera(source, libcamera_cameras()));
  }
  return findings;
}

Finding check_libcamera(const std::string& source, const std::vector<std::string>& ids) {
  std::string known;
  for (const std::string& id : ids) {
    if (source == "libcamera:" + id) return well("camera", source + ": libcamera knows it");
    known += (known.empty() ? "" : ", ") + id;
  }
  return fault("camera", source + ": libcamera knows " +
                             (ids.empty() ? "no camera (if this lcdm was built with it)" : known) +
                             ": set camera.source to one that `lcdm probe` lists");
}

Finding check_rate(const std::vector<V4l2Mode>& modes, const CaptureRequest& request) {
  const auto choice = choose_mode(modes, request);
  if (!choice) return fault("rate", "the camera offers no format that lcdm reads");
  float best = 0;
  for (const V4l2Mode& mode : modes) {
    const bool chosen = mode.fourcc == choice->fourcc && mode.width <= choice->width &&
                        choice->width <= mode.max_width && mode.height <= choice->height &&
                        choice->height <= mode.max_height;
    if (chosen)
      for (const float rate : mode.rates) best = std::max(best, rate);
  }
  const std::string mode = std::string(to_string(choice->pixel)) + " " +
                           std::to_string(choice->width) + "x" + std::to_string(choice->height);
  if (best == 0) return well("rate", mode + ": the driver lists no rates");
  const std::string rate = mode + " at " + number(static_cast<double>(best)) + " frames/s";
  if (best < 0.95F * request.frames_per_second) {
    return warning("rate", rate + ", " + number(static_cast<double>(request.frames_per_second)) +
                               " are wanted: set a smaller camera.width and height (`lcdm probe`), "
                               "or a lower camera.frames_per_second");
  }
  return well("rate", rate);
}

Finding check_arrivals(const Result<float>& measured, float wanted) {
  if (!measured && measured.code() == StatusCode::kUnavailable) {
    return well("rate", std::string("not measured: ") + measured.status().text());
  }
  if (!measured) return fault("rate", measured.status().text());
  char text[64];
  std::snprintf(text, sizeof(text), "%.1f frames/s come of %g", static_cast<double>(*measured),
                static_cast<double>(wanted));
  if (*measured >= 0.8F * wanted) return well("rate", text);
  return warning("rate", std::string(text) +
                             ": give it more light or a shorter camera.exposure_ms, a USB bus of "
                             "its own, or a smaller camera.width and height");
}

std::vector<Finding> check_rates(const Config& config, const std::vector<V4l2Node>& nodes) {
  const std::string& source = config.camera.source;
  if (after_scheme(source, "libcamera:")) {
    const bool known = check_libcamera(source, libcamera_cameras()).severity == Severity::kOk;
    return known ? std::vector{try_camera(source, config)} : std::vector<Finding>{};
  }
  const std::string node = configured_node(source, nodes);
  std::vector<Finding> findings;
  {
    V4l2Device device;
    if (node.empty() || !device.open(node)) return {};
    const CaptureRequest request = capture_request(config);
    findings.push_back(check_rate(list_modes(device, request), request));
  }
  findings.push_back(try_camera(source == "auto" ? "v4l2:" + node : source, config));
  return findings;
}

}  // namespace lcdm
