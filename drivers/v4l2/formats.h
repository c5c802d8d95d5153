// What a V4L2 node offers, and which of it is cheapest for us.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "drivers/v4l2/device.h"
#include "firmware/buffer/frame.h"
#include "firmware/pipeline/camera.h"

namespace lcdm {

// One size of one format, or a range of sizes.
struct V4l2Mode {
  std::uint32_t fourcc = 0;
  int width = 0;             // pixels, the least of a range; 0: the driver lists no sizes
  int height = 0;            //
  int max_width = 0;         // of a range; as width where there is one size
  int max_height = 0;        //
  std::vector<float> rates;  // frames/s, as the driver orders them; may be empty
  int step_width = 1;        // of a range, from width on
  int step_height = 1;       //
};

// Everything the node lists, in its order; bounded, whatever it answers. The rates of a range are
// those at its size nearest to the request.
std::vector<V4l2Mode> list_modes(const V4l2Device& device, const CaptureRequest& request);

// The mode with its range narrowed to the size nearest to the request, which is what is asked for.
V4l2Mode narrowed(V4l2Mode mode, const CaptureRequest& request);

// "YUYV"; characters that are none become '?'.
std::string fourcc_text(std::uint32_t fourcc);

// Null where we do not read that format.
std::optional<PixelFormat> pixel_format_of(std::uint32_t fourcc);

struct V4l2Choice {
  std::uint32_t fourcc = 0;
  PixelFormat pixel = PixelFormat::kYuyv;
  int width = 0;  // pixels, the listed size nearest to the request
  int height = 0;
  std::string reason;  // "over MJPEG: needs no decoding"; empty where there was no choice
};

// For each format its size nearest to the request is looked at. Of those: the nearest size, then
// the rate reached, then colour over grey, then no decoding over decoding, then the fewest bytes.
// Pure. Empty when no listed format is one we read, or the one the request names.
std::optional<V4l2Choice> choose_mode(const std::vector<V4l2Mode>& modes,
                                      const CaptureRequest& request);

// The refusal where choose_mode gives none: names what is offered and what was wanted.
Status no_known_format(const V4l2Device& device, const std::vector<V4l2Mode>& modes,
                       const CaptureRequest& request);

}  // namespace lcdm
