#include "drivers/v4l2/nodes.h"

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <system_error>
#include <utility>

#include "drivers/v4l2/device.h"
#include "drivers/v4l2/formats.h"
#include "firmware/base/folder.h"
#include "firmware/base/printable.h"

namespace lcdm {
namespace {

namespace fs = std::filesystem;

std::vector<std::string> node_paths() {
  std::vector<std::pair<long, std::string>> paths;
  const auto devices = list_folder("/dev");
  if (!devices) return {};
  for (const fs::path& device : *devices) {
    const std::string name = device.filename().string();
    if (name.rfind("video", 0) != 0 || name.size() == 5) continue;
    char* end = nullptr;
    const long number = std::strtol(name.c_str() + 5, &end, 10);
    if (*end == '\0') paths.emplace_back(number, device.string());
  }
  std::sort(paths.begin(), paths.end());
  std::vector<std::string> sorted;
  sorted.reserve(paths.size());
  for (auto& [number, path] : paths) sorted.push_back(std::move(path));
  return sorted;
}

// The first line of a kernel attribute; empty when there is none.
std::string attribute(const fs::path& folder, const char* name) {
  std::ifstream file(folder / name);
  std::string line;
  std::getline(file, line);
  return printable(line.substr(std::min(line.find_first_not_of(' '), line.size())));
}

// The kernel's folder of the USB device a video node belongs to; empty: it is not on USB.
fs::path usb_folder_of(const std::string& video_node) {
  std::error_code error;
  const fs::path node = fs::canonical(video_node, error);
  fs::path folder = fs::canonical("/sys/class/video4linux" / node.filename() / "device", error);
  for (; !error && folder.has_relative_path(); folder = folder.parent_path()) {
    if (!attribute(folder, "busnum").empty()) return folder;
  }
  return {};
}

std::string usb_node_in(const fs::path& folder) {
  const long bus = std::strtol(attribute(folder, "busnum").c_str(), nullptr, 10);
  const long device = std::strtol(attribute(folder, "devnum").c_str(), nullptr, 10);
  if (bus <= 0 || device <= 0) return "";
  char path[64];
  std::snprintf(path, sizeof(path), "/dev/bus/usb/%03ld/%03ld", bus, device);
  return path;
}

// udev's name for the port that a node's camera is plugged into; the node where there is none.
std::string port_link_of(const std::string& node) {
  const auto links = list_folder("/dev/v4l/by-path");
  for (const fs::path& link : links ? *links : std::vector<fs::path>{}) {
    std::error_code error;
    if (fs::canonical(link, error) == node) return link.string();
  }
  return node;
}

V4l2Node examine(const std::string& path) {
  V4l2Node node;
  node.path = path;
  V4l2Device device;
  const Status opened = device.open(path);
  node.card = device.card();
  node.driver = device.driver();
  node.bus = device.bus();
  if (!opened) {
    node.reason = opened.text();
    node.broken = opened.code() == StatusCode::kIoError;
    if (node.broken) {
      node.card = attribute("/sys/class/video4linux" / fs::path(path).filename(), "name");
    }
  } else {
    const std::vector<V4l2Mode> modes = list_modes(device, {});
    node.usable = choose_mode(modes, {}).has_value();
    if (!node.usable) node.reason = no_known_format(device, modes, {}).text();
  }
  if (const fs::path usb = usb_folder_of(path); !usb.empty()) {
    node.usb = usb_node_in(usb);
    node.serial = attribute(usb, "serial");
    node.usb_mbps = std::strtof(attribute(usb, "speed").c_str(), nullptr);
    node.usb_version = std::strtof(attribute(usb, "version").c_str(), nullptr);
  }
  return node;
}

}  // namespace

std::vector<V4l2Node> list_v4l2_nodes() {
  std::vector<V4l2Node> nodes;
  for (const std::string& path : node_paths()) nodes.push_back(examine(path));
  return nodes;
}

Result<std::string> find_v4l2_node(const std::string& selector) {
  const bool any = selector == "any";
  const bool by_serial = selector.rfind("serial=", 0) == 0;
  const bool by_name = selector.rfind("name=", 0) == 0;
  if (!any && !by_serial && !by_name) return selector;
  const std::string wanted = any ? "" : selector.substr(selector.find('=') + 1);
  std::string reasons;
  std::string broken;
  for (const V4l2Node& node : list_v4l2_nodes()) {
    if (!any && wanted != (by_serial ? node.serial : node.card)) continue;
    if (node.usable) return node.path;
    if (node.broken && broken.empty()) broken = node.path;
    reasons += (reasons.empty() ? "" : "; ") + node.reason;
  }
  // One that is there and locked, or that fails, is no absence: waiting for it would be for ever.
  if (!broken.empty()) return broken;
  if (!reasons.empty()) {
    return Status::error(StatusCode::kNotFound, "v4l2:%.80s: no usable camera: %s",
                         selector.c_str(), reasons.c_str());
  }
  return Status::error(StatusCode::kNotFound,
                       "v4l2:%.120s: no such camera: is it plugged in? `lcdm probe` lists those "
                       "that are",
                       selector.c_str());
}

std::string lasting_selector(const V4l2Node& node, const std::vector<V4l2Node>& all) {
  const auto is_alone = [&](const std::string V4l2Node::*what) {
    const auto same = [&](const V4l2Node& other) {
      return other.usable && other.*what == node.*what;
    };
    return !(node.*what).empty() && std::count_if(all.begin(), all.end(), same) == 1;
  };
  if (is_alone(&V4l2Node::serial)) return "serial=" + node.serial;
  if (is_alone(&V4l2Node::card)) return "name=" + node.card;
  return port_link_of(node.path);
}

std::string usb_node_of(const std::string& video_node) {
  const fs::path folder = usb_folder_of(video_node);
  return folder.empty() ? "" : usb_node_in(folder);
}

}  // namespace lcdm
