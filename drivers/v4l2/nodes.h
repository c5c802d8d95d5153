// Which /dev/video* nodes there are, what is behind each, and which of them a text means.
#pragma once

#include <string>
#include <vector>

#include "firmware/base/status.h"

namespace lcdm {

// One /dev/video* node, and why it is of no use if it is not.
struct V4l2Node {
  std::string path;
  std::string card;       // the camera's name
  std::string driver;     // the kernel module
  std::string bus;        // where it is plugged in, as the driver says it
  std::string serial;     // of the USB device; empty: none known
  std::string usb;        // the USB device's own node, /dev/bus/usb/001/004; empty: not on USB
  float usb_mbps = 0;     // the speed USB agreed on; 0: not on USB
  float usb_version = 0;  // that the camera was made for, as 3.2; 0: not on USB
  bool usable = false;    // captures video by streaming, in a format we read
  bool broken = false;    // cannot be opened, by this user or now; `card` is the kernel's name then
  std::string reason;     // when not usable: one line that names it, with the cure
};

// Every /dev/video* node, in the order of their numbers. Opens each for a moment.
std::vector<V4l2Node> list_v4l2_nodes();

// The node that `selector` means now: a path (a node, or a link as /dev/v4l/by-id/...), any (the
// first usable node), serial=TEXT or name=TEXT (the first usable node of the camera with exactly
// that serial or name); where none is usable the first that is broken: opening it says why.
// kNotFound: no such camera is plugged in, or none that is usable. A path is not looked at.
Result<std::string> find_v4l2_node(const std::string& selector);

// What means `node` also after replugging and restarting, while `all` are there: its serial, its
// name, or, where another camera has the same, the link that udev makes to its port.
std::string lasting_selector(const V4l2Node& node, const std::vector<V4l2Node>& all);

// The node of the USB device behind a video node (or a link to one); empty: it is not on USB.
std::string usb_node_of(const std::string& video_node);

}  // namespace lcdm
