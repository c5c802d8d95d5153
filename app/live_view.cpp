#include "app/live_view.h"

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <utility>

#include "firmware/base/os.h"

namespace lcdm {
namespace {

constexpr int kNiceSteps = 5;

std::size_t depth_values(const DepthFrame& frame) {
  return static_cast<std::size_t>(frame.camera.width) *
         static_cast<std::size_t>(frame.camera.height);
}

}  // namespace

LiveView::LiveView(std::string source_name) : source_name_(std::move(source_name)) {
  thread_ = std::thread([this] { run(); });
}

void LiveView::stop() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
  }
  offered_.notify_all();
  if (thread_.joinable()) thread_.join();
  for (Slot& each : slots_) {
    const std::lock_guard lock(each.mutex);
    each.closed = true;
    each.filled.notify_all();
  }
}

void LiveView::offer(const DepthFrame& frame) noexcept {
  const std::uint64_t number = number_.load(std::memory_order_relaxed) + 1;
  number_.store(number, std::memory_order_relaxed);
  const bool anybody = std::any_of(slots_.begin(), slots_.end(),
                                   [](const Slot& each) { return each.subscribers.load() > 0; });
  if (!anybody) return;
  const std::unique_lock lock(mutex_, std::try_to_lock);
  if (!lock) return;
  const std::size_t colour_bytes = picture_bytes(frame.pixels.format);
  const std::size_t depth_count = depth_values(frame);
  if (colour_bytes > incoming_.colour.size() || depth_count > incoming_.depth.size()) {
    needed_colour_ = colour_bytes;  // the encode thread makes room; the next frame fits
    needed_depth_ = depth_count;
  } else {
    std::memcpy(incoming_.colour.data(), frame.pixels.data, colour_bytes);
    std::memcpy(incoming_.depth.data(), frame.millimetres, depth_count * sizeof(std::uint16_t));
    incoming_.frame = frame;
    incoming_.frame.colour = {};  // not copied
    incoming_.number = number;
  }
  offered_.notify_one();
}

// ---- encode thread ------------------------------------------------------------------------------

void LiveView::run() {
  os::set_thread_name("encode");
  os::lower_thread_priority(kNiceSteps);
  while (fetch()) {
    heartbeat_.beat(os::monotonic_ns());
    encode();
    heartbeat_.rest();
  }
}

// Swaps the newest offered frame into working_. False when it is time to end.
bool LiveView::fetch() {
  std::unique_lock lock(mutex_);
  while (true) {
    if (stopping_) return false;
    if (needed_colour_ > 0) {
      for (FrameCopy* copy : {&incoming_, &working_}) {
        copy->colour.resize(std::max(copy->colour.size(), needed_colour_));
        copy->depth.resize(std::max(copy->depth.size(), needed_depth_));
      }
      needed_colour_ = 0;
    }
    if (incoming_.number > working_.number) break;
    offered_.wait(lock);
  }
  std::swap(incoming_, working_);
  working_.frame.pixels.data = working_.colour.data();
  working_.frame.millimetres = working_.depth.data();
  return true;
}

void LiveView::encode() {
  if (wanted(Product::kLive) || wanted(Product::kColourJpeg)) encode_colour();
  if (wanted(Product::kDepthJpeg) || wanted(Product::kSideJpeg)) encode_painted();
  if (wanted(Product::kDepthPng)) encode_png();
}

void LiveView::encode_colour() {
  const Result<std::span<const std::byte>> jpeg = colour_jpeg_.encode(working_.frame.pixels);
  if (!jpeg) return;
  if (wanted(Product::kColourJpeg)) publish(Product::kColourJpeg, *jpeg);
  if (!wanted(Product::kLive)) return;
  publish(Product::kLive, *jpeg,
          std::as_bytes(std::span(working_.depth).first(depth_values(working_.frame))));
}

void LiveView::encode_picture(Product product, JpegWriter& writer, const RgbPicture& picture) {
  const Result<std::span<const std::byte>> jpeg = writer.encode(picture.view());
  if (jpeg) publish(product, *jpeg);
}

void LiveView::encode_painted() {
  const std::span<const std::uint16_t> depth =
      std::span(working_.depth).first(depth_values(working_.frame));
  if (const auto range = range_of(depth)) {
    colours_.set_range(has_range_ ? approach(colours_.range(), *range) : *range);
    has_range_ = true;
  }
  depth_picture_.resize(working_.frame.camera.width, working_.frame.camera.height);
  colours_.paint(depth, depth_picture_.pixels);
  if (wanted(Product::kDepthJpeg)) encode_picture(Product::kDepthJpeg, depth_jpeg_, depth_picture_);
  if (!wanted(Product::kSideJpeg)) return;
  to_rgb(working_.frame.pixels, colour_picture_);
  put_side_by_side(colour_picture_, depth_picture_, side_picture_);
  encode_picture(Product::kSideJpeg, side_jpeg_, side_picture_);
}

void LiveView::encode_png() {
  const DepthFrame& frame = working_.frame;
  const CameraModel& camera = frame.camera;
  const std::array<ImageText, 10> texts = {{{"scale", to_string(frame.scale)},
                                            {"unit", "millimetre"},
                                            {"source", source_name_},
                                            {"sequence", std::to_string(frame.meta.sequence)},
                                            {"unix_ns", std::to_string(frame.meta.unix_ns)},
                                            {"fx", std::to_string(camera.fx)},
                                            {"fy", std::to_string(camera.fy)},
                                            {"cx", std::to_string(camera.cx)},
                                            {"cy", std::to_string(camera.cy)},
                                            {"calibrated", camera.calibrated ? "yes" : "no"}}};
  const Status status = encode_depth_png(std::span(working_.depth).first(depth_values(frame)),
                                         camera.width, camera.height, texts, png_);
  if (status) publish(Product::kDepthPng, png_);
}

// `depth`: behind the picture, in the product of both.
void LiveView::publish(Product product, std::span<const std::byte> picture,
                       std::span<const std::byte> depth) {
  Slot& target = slot(product);
  {
    const std::lock_guard lock(target.mutex);
    const DepthFrame& frame = working_.frame;
    target.product = {working_.number, frame.meta,     frame.camera,
                      frame.scale,     picture.size(), std::move(target.product.bytes)};
    target.product.bytes.assign(picture.begin(), picture.end());
    target.product.bytes.insert(target.product.bytes.end(), depth.begin(), depth.end());
  }
  target.filled.notify_all();
}

// ---- viewers' threads ---------------------------------------------------------------------------

LiveView::Wait LiveView::wait_newer(Product product, std::uint64_t after,
                                    std::chrono::milliseconds timeout, ProductCopy& out) {
  Slot& source = slot(product);
  std::unique_lock lock(source.mutex);
  const bool came = source.filled.wait_for(
      lock, timeout, [&] { return source.closed || source.product.number > after; });
  if (source.closed) return Wait::kClosed;
  if (!came) return Wait::kTimeout;
  out = source.product;
  return Wait::kNewer;
}

}  // namespace lcdm
