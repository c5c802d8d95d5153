// lcdm probe: which cameras are there, and what can each do?
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <unistd.h>
#include <vector>

#include "app/commands/commands.h"
#include "app/json_text.h"
#ifdef LCDM_LIBCAMERA
#include "drivers/libcamera/camera.h"
#endif
#include "drivers/v4l2/device.h"
#include "drivers/v4l2/formats.h"
#include "drivers/v4l2/nodes.h"
#include "drivers/v4l2/queue.h"
#include "firmware/base/exit_code.h"

namespace lcdm {
namespace {

// What `lcdm run` asks for by default: a range of sizes has its rates told for the nearest of them.
constexpr CaptureRequest kRequest{};

struct Probed {
  V4l2Node node;
  std::vector<V4l2Mode> modes;  // empty where the node is not usable
  // Whether its buffers can be had as dma-bufs; empty where another program holds them.
  std::optional<bool> shares_buffers;
};

std::optional<bool> shares_buffers(const V4l2Device& device) {
  V4l2Queue queue(device);
  if (!queue.map()) return std::nullopt;
  const Result<int> shared = queue.export_buffer(0);
  if (shared) close(*shared);
  return shared.is_ok();
}

std::vector<Probed> probe_v4l2() {
  std::vector<Probed> found;
  for (V4l2Node& node : list_v4l2_nodes()) {
    Probed probed{std::move(node), {}, {}};
    V4l2Device device;
    if (probed.node.usable && device.open(probed.node.path)) {
      probed.modes = list_modes(device, kRequest);
      probed.shares_buffers = shares_buffers(device);
    }
    found.push_back(std::move(probed));
  }
  return found;
}

std::vector<std::string> probe_libcamera() {
#ifdef LCDM_LIBCAMERA
  return list_libcamera_cameras();
#else
  return {};
#endif
}

bool is_range(const V4l2Mode& mode) {
  return mode.max_width != mode.width || mode.max_height != mode.height;
}

// "640x480", or "16x16 to 4096x2160, 640x480:".
std::string size_text(const V4l2Mode& mode) {
  const auto size = [](int width, int height) {
    return std::to_string(width) + "x" + std::to_string(height);
  };
  if (mode.width == 0) return "any size";
  std::string text = size(mode.width, mode.height);
  if (!is_range(mode)) return text;
  text += " to " + size(mode.max_width, mode.max_height);
  const V4l2Mode nearest = narrowed(mode, kRequest);
  return mode.rates.empty() ? text : text + ", " + size(nearest.width, nearest.height) + ":";
}

void print_mode(const V4l2Mode& mode) {
  std::printf("    %-5s %-12s", fourcc_text(mode.fourcc).c_str(), size_text(mode).c_str());
  for (const float rate : mode.rates) std::printf(" %g", static_cast<double>(rate));
  std::printf("%s%s\n", mode.rates.empty() ? "" : " frames/s",
              pixel_format_of(mode.fourcc) ? "" : " (not read by lcdm)");
}

// As one word of a shell's command line.
std::string quoted(const std::string& text) {
  std::string result = "'";
  for (const char letter : text) result += letter == '\'' ? "'\\''" : std::string(1, letter);
  return result + "'";
}

void print_node(const Probed& probed, const std::vector<V4l2Node>& all) {
  const V4l2Node& node = probed.node;
  if (!node.usable) {
    std::printf("%s\n    not usable: %s\n", node.path.c_str(), node.reason.c_str());
    return;
  }
  std::printf("%s  %s\n    driver %s, at %s", node.path.c_str(), node.card.c_str(),
              node.driver.c_str(), node.bus.c_str());
  if (node.usb_mbps > 0) {
    std::printf(", USB at %g Mb/s (made for USB %g)", static_cast<double>(node.usb_mbps),
                static_cast<double>(node.usb_version));
  }
  std::printf("\n    --source %s\n", quoted("v4l2:" + lasting_selector(node, all)).c_str());
  for (const V4l2Mode& mode : probed.modes) print_mode(mode);
  if (probed.shares_buffers.value_or(false)) std::printf("    buffers can be had as dma-bufs\n");
}

nlohmann::json mode_json(const V4l2Mode& mode) {
  return {{"format", fourcc_text(mode.fourcc)},
          {"readable", pixel_format_of(mode.fourcc).has_value()},
          {"width", mode.width},
          {"height", mode.height},
          {"max_width", mode.max_width},
          {"max_height", mode.max_height},
          {"frames_per_second", mode.rates}};
}

nlohmann::json node_json(const Probed& probed) {
  const V4l2Node& node = probed.node;
  nlohmann::json json = {{"path", node.path},         {"card", node.card},
                         {"driver", node.driver},     {"bus", node.bus},
                         {"serial", node.serial},     {"usb", node.usb},
                         {"usb_mbps", node.usb_mbps}, {"usb_version", node.usb_version},
                         {"usable", node.usable},     {"reason", node.reason},
                         {"dma_buf", nullptr},        {"modes", nlohmann::json::array()}};
  if (probed.shares_buffers) json["dma_buf"] = *probed.shares_buffers;
  for (const V4l2Mode& mode : probed.modes) json["modes"].push_back(mode_json(mode));
  return json;
}

int probe(bool as_json) {
  const std::vector<Probed> nodes = probe_v4l2();
  const std::vector<std::string> ids = probe_libcamera();
  if (as_json) {
    nlohmann::json json = {{"v4l2", nlohmann::json::array()}, {"libcamera", ids}};
    for (const Probed& probed : nodes) json["v4l2"].push_back(node_json(probed));
    std::printf("%s", json_text(json).c_str());
    return kExitOk;
  }
  std::vector<V4l2Node> all;
  all.reserve(nodes.size());
  for (const Probed& probed : nodes) all.push_back(probed.node);
  for (const Probed& probed : nodes) print_node(probed, all);
  for (const std::string& id : ids) {
    std::printf("--source %s\n", quoted("libcamera:" + id).c_str());
  }
  if (nodes.empty() && ids.empty()) std::printf("no camera found (no /dev/video*)\n");
  return kExitOk;
}

}  // namespace

void add_probe_command(CLI::App& program, int& exit_code) {
  auto as_json = std::make_shared<bool>(false);
  CLI::App* command = program.add_subcommand(
      "probe", "The cameras that are there: formats, sizes, rates, bus speed");
  command->add_flag("--json", *as_json, "As JSON");
  command->callback([as_json, &exit_code] { exit_code = probe(*as_json); });
}

}  // namespace lcdm
