#include "drivers/v4l2/formats.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdlib>

namespace lcdm {
namespace {

// An end for a driver whose list has none. The longest known, of the kernel's test driver, has some
// ninety formats.
constexpr std::uint32_t kMostEntries = 256;

struct KnownFormat {
  std::uint32_t fourcc;
  PixelFormat pixel;
};
// V4L2 names bytes in memory: its RGB3 is R, G, B.
constexpr KnownFormat kKnownFormats[] = {
    {V4L2_PIX_FMT_YUYV, PixelFormat::kYuyv},   {V4L2_PIX_FMT_UYVY, PixelFormat::kUyvy},
    {V4L2_PIX_FMT_NV12, PixelFormat::kNv12},   {V4L2_PIX_FMT_NV21, PixelFormat::kNv21},
    {V4L2_PIX_FMT_RGB24, PixelFormat::kRgb24}, {V4L2_PIX_FMT_BGR24, PixelFormat::kBgr24},
    {V4L2_PIX_FMT_GREY, PixelFormat::kGrey},   {V4L2_PIX_FMT_MJPEG, PixelFormat::kMjpeg},
};

float rate_of(const v4l2_fract& period) {
  return period.numerator == 0
             ? 0
             : static_cast<float>(period.denominator) / static_cast<float>(period.numerator);
}

// At the mode's least size.
std::vector<float> list_rates(const V4l2Device& device, const V4l2Mode& mode) {
  v4l2_frmivalenum interval{};
  interval.pixel_format = mode.fourcc;
  interval.width = static_cast<std::uint32_t>(mode.width);
  interval.height = static_cast<std::uint32_t>(mode.height);
  std::vector<float> rates;
  for (; interval.index < kMostEntries; ++interval.index) {
    if (device.control(VIDIOC_ENUM_FRAMEINTERVALS, &interval) != 0) break;
    const bool discrete = interval.type == V4L2_FRMIVAL_TYPE_DISCRETE;
    const float rate = rate_of(discrete ? interval.discrete : interval.stepwise.min);
    if (rate > 0) rates.push_back(rate);
    if (!discrete) break;
  }
  return rates;
}

// Of least, least + step, ... up to most, the one nearest to `wanted`.
int nearest_step(int wanted, int least, int most, int step) {
  const int last = most > least ? (most - least) / step : 0;
  return least + std::clamp((wanted - least + step / 2) / step, 0, last) * step;
}

int bounded_side(std::uint32_t side) { return static_cast<int>(std::min(side, 1U << 16)); }

void list_sizes(const V4l2Device& device, V4l2Mode mode, const CaptureRequest& request,
                std::vector<V4l2Mode>& modes) {
  v4l2_frmsizeenum size{};
  size.pixel_format = mode.fourcc;
  for (; size.index < kMostEntries; ++size.index) {
    if (device.control(VIDIOC_ENUM_FRAMESIZES, &size) != 0) break;
    const bool discrete = size.type == V4L2_FRMSIZE_TYPE_DISCRETE;
    mode.width = bounded_side(discrete ? size.discrete.width : size.stepwise.min_width);
    mode.height = bounded_side(discrete ? size.discrete.height : size.stepwise.min_height);
    mode.max_width = discrete ? mode.width : bounded_side(size.stepwise.max_width);
    mode.max_height = discrete ? mode.height : bounded_side(size.stepwise.max_height);
    mode.step_width = discrete ? 1 : bounded_side(std::max(size.stepwise.step_width, 1U));
    mode.step_height = discrete ? 1 : bounded_side(std::max(size.stepwise.step_height, 1U));
    mode.rates = list_rates(device, narrowed(mode, request));
    modes.push_back(mode);
    if (!discrete) return;
  }
  // Listed without any size: S_FMT will say.
  if (size.index == 0) modes.push_back(mode);
}

// Mean bytes of a pixel, as they cross the bus.
float bytes_per_pixel(PixelFormat pixel) {
  switch (pixel) {
    case PixelFormat::kGrey:
      return 1;
    case PixelFormat::kNv12:
    case PixelFormat::kNv21:
      return 1.5F;
    case PixelFormat::kYuyv:
    case PixelFormat::kUyvy:
      return 2;
    case PixelFormat::kRgb24:
    case PixelFormat::kBgr24:
      return 3;
    case PixelFormat::kMjpeg:
      return 0.3F;
  }
  return 0;
}

// What a mode costs us; the first figure in which two differ decides, the smaller is better.
struct Cost {
  static constexpr std::array<const char*, 5> kReasons = {"nearer to the size asked for",
                                                          "reaches the rate", "has colour",
                                                          "needs no decoding", "fewest bytes"};
  std::array<float, 5> figures{};
};

float size_distance(const V4l2Mode& mode, const CaptureRequest& request) {
  return static_cast<float>(std::abs(mode.width - request.width) +
                            std::abs(mode.height - request.height));
}

// The part of the wanted rate that is missing, from 0 to 1; 5 % are no matter.
float rate_deficit(const V4l2Mode& mode, float wanted) {
  if (mode.rates.empty()) return 0;
  const float best = *std::max_element(mode.rates.begin(), mode.rates.end());
  const float missing = 1 - best / wanted;
  return missing <= 0.05F ? 0 : missing;
}

Cost cost_of(const V4l2Mode& mode, PixelFormat pixel, const CaptureRequest& request) {
  return {{size_distance(mode, request), rate_deficit(mode, request.frames_per_second),
           pixel == PixelFormat::kGrey ? 1.0F : 0.0F, pixel == PixelFormat::kMjpeg ? 1.0F : 0.0F,
           bytes_per_pixel(pixel)}};
}

std::optional<V4l2Mode> nearest_of(const std::vector<V4l2Mode>& modes, std::uint32_t fourcc,
                                   const CaptureRequest& request) {
  std::optional<V4l2Mode> nearest;
  for (const V4l2Mode& listed : modes) {
    if (listed.fourcc != fourcc) continue;
    const V4l2Mode mode = narrowed(listed, request);
    if (!nearest || size_distance(mode, request) < size_distance(*nearest, request)) nearest = mode;
  }
  return nearest;
}

struct Candidate {
  V4l2Mode mode;
  PixelFormat pixel;
  Cost cost;
};

// "over MJPEG: needs no decoding".
std::string reason_for(const Candidate& chosen, const Candidate& second) {
  const auto& ours = chosen.cost.figures;
  for (std::size_t i = 0; i < ours.size(); ++i) {
    if (ours[i] == second.cost.figures[i]) continue;
    return std::string("over ") + to_string(second.pixel) + ": " + Cost::kReasons[i];
  }
  return "";  // equal: the order of our list
}

}  // namespace

std::optional<PixelFormat> pixel_format_of(std::uint32_t fourcc) {
  for (const KnownFormat& known : kKnownFormats) {
    if (known.fourcc == fourcc) return known.pixel;
  }
  return std::nullopt;
}

std::string fourcc_text(std::uint32_t fourcc) {
  std::string text;
  for (int shift = 0; shift < 32; shift += 8) {
    const auto letter = static_cast<char>((fourcc >> shift) & 0x7F);
    text += letter > ' ' && letter <= '~' ? letter : (letter == ' ' ? ' ' : '?');
  }
  return text.substr(0, text.find_last_not_of(' ') + 1);
}

V4l2Mode narrowed(V4l2Mode mode, const CaptureRequest& request) {
  if (mode.width == 0) {  // listed without sizes: S_FMT will say
    mode.width = request.width;
    mode.height = request.height;
  } else {
    mode.width = nearest_step(request.width, mode.width, mode.max_width, mode.step_width);
    mode.height = nearest_step(request.height, mode.height, mode.max_height, mode.step_height);
  }
  mode.max_width = mode.width;
  mode.max_height = mode.height;
  return mode;
}

std::vector<V4l2Mode> list_modes(const V4l2Device& device, const CaptureRequest& request) {
  std::vector<V4l2Mode> modes;
  v4l2_fmtdesc description{};
  description.type = device.queue();
  for (; description.index < kMostEntries; ++description.index) {
    if (device.control(VIDIOC_ENUM_FMT, &description) != 0) break;
    V4l2Mode mode;
    mode.fourcc = description.pixelformat;
    list_sizes(device, mode, request, modes);
  }
  return modes;
}

std::optional<V4l2Choice> choose_mode(const std::vector<V4l2Mode>& modes,
                                      const CaptureRequest& request) {
  std::vector<Candidate> candidates;
  for (const auto& [fourcc, pixel] : kKnownFormats) {
    if (request.format.value_or(pixel) != pixel) continue;
    const auto mode = nearest_of(modes, fourcc, request);
    if (mode) candidates.push_back({*mode, pixel, cost_of(*mode, pixel, request)});
  }
  if (candidates.empty()) return std::nullopt;
  std::stable_sort(
      candidates.begin(), candidates.end(),
      [](const Candidate& a, const Candidate& b) { return a.cost.figures < b.cost.figures; });
  const Candidate& best = candidates[0];
  return V4l2Choice{best.mode.fourcc, best.pixel, best.mode.width, best.mode.height,
                    candidates.size() < 2 ? "" : reason_for(best, candidates[1])};
}

Status no_known_format(const V4l2Device& device, const std::vector<V4l2Mode>& modes,
                       const CaptureRequest& request) {
  std::string offered;
  std::uint32_t last = 0;
  for (const V4l2Mode& mode : modes) {
    if (mode.fourcc != last) offered += (offered.empty() ? "" : ", ") + fourcc_text(mode.fourcc);
    last = mode.fourcc;
  }
  if (request.format) {
    return Status::error(StatusCode::kUnsupported,
                         "v4l2:%s (%.32s): offers no %s, only %.80s: leave camera.format empty",
                         device.path().c_str(), device.card().c_str(), to_string(*request.format),
                         offered.empty() ? "no format" : offered.c_str());
  }
  return Status::error(StatusCode::kUnsupported,
                       "v4l2:%s (%.32s): offers %.60s; we read YUYV, UYVY, NV12, NV21, RGB24, "
                       "BGR24, GREY and MJPEG in one plane of memory: try libcamera:",
                       device.path().c_str(), device.card().c_str(),
                       offered.empty() ? "no format" : offered.c_str());
}

}  // namespace lcdm
