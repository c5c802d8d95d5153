// The newest frame as what viewers want: JPEG, PNG, raw depth. Each is made once per frame, by one
// thread, and only while somebody subscribes to it.
#pragma once

#include <array>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include "app/depth_colour.h"
#include "app/rgb_picture.h"
#include "drivers/codec/codec.h"
#include "firmware/health/heartbeat.h"
#include "firmware/pipeline/depth_sink.h"

namespace lcdm {

enum class Product : std::uint8_t {
  kColourJpeg,
  kDepthJpeg,  // colour-mapped
  kSideJpeg,   // colour | depth
  kDepthPng,   // 16 bit, millimetres, with text chunks
  kLive,       // the colour JPEG, then the raw depth: little-endian uint16 millimetres
};
constexpr std::size_t kProducts = 5;

// A finished product and the frame it was made from.
struct ProductCopy {
  std::uint64_t number = 0;  // rises by one or more with every frame; 0: none yet
  FrameMeta meta;
  CameraModel camera;  // of the depth
  ScaleKind scale = ScaleKind::kRelative;
  std::size_t picture_bytes = 0;  // how many of `bytes` are the picture; kLive: the rest is depth
  std::vector<std::byte> bytes;
};

// Threads: offer is called by infer; the encoding happens on a low-priority thread `encode` of its
// own; subscribe and wait_newer are for any thread. Between them stand two frame copies: one being
// filled, one being encoded. A frame that comes while the former is locked is dropped.
class LiveView final : public DepthSink {
 public:
  enum class Wait : std::uint8_t {
    kNewer,
    kTimeout,
    kClosed,  // there will be no more
  };

  // Keeps a product coming for as long as it lives.
  class Subscription {
   public:
    Subscription(LiveView& view, Product product) : view_(view), product_(product) {
      view_.slot(product_).subscribers.fetch_add(1);
    }
    ~Subscription() { view_.slot(product_).subscribers.fetch_sub(1); }
    Subscription(const Subscription&) = delete;
    Subscription& operator=(const Subscription&) = delete;

    // Waits for a frame after number `after` and copies it.
    Wait wait_newer(std::uint64_t after, std::chrono::milliseconds timeout, ProductCopy& out) {
      return view_.wait_newer(product_, after, timeout, out);
    }

   private:
    LiveView& view_;
    const Product product_;
  };

  // `source_name` goes into the PNG's text chunks.
  explicit LiveView(std::string source_name);
  ~LiveView() override { stop(); }
  LiveView(const LiveView&) = delete;
  LiveView& operator=(const LiveView&) = delete;

  void offer(const DepthFrame& frame) noexcept override;

  // Wakes every waiting viewer for good and joins the thread.
  void stop();
  // The number of the newest frame that was offered, encoded or not.
  std::uint64_t newest() const { return number_.load(); }
  // Of the thread `encode`: rests while there is nothing to encode.
  const Heartbeat& heartbeat() const { return heartbeat_; }

 private:
  // A frame of our own. The vectors only grow, and only on the encode thread.
  struct FrameCopy {
    std::uint64_t number = 0;
    DepthFrame frame;  // its pointers point into the vectors
    std::vector<std::uint8_t> colour;
    std::vector<std::uint16_t> depth;
  };
  struct Slot {
    std::atomic<int> subscribers{0};
    std::mutex mutex;
    std::condition_variable filled;
    ProductCopy product;
    bool closed = false;
  };

  Slot& slot(Product product) { return slots_[static_cast<std::size_t>(product)]; }
  bool wanted(Product product) { return slot(product).subscribers.load() > 0; }
  Wait wait_newer(Product product, std::uint64_t after, std::chrono::milliseconds timeout,
                  ProductCopy& out);

  void run();
  bool fetch();
  void encode();
  void encode_colour();
  void encode_painted();
  void encode_png();
  void encode_picture(Product product, JpegWriter& writer, const RgbPicture& picture);
  void publish(Product product, std::span<const std::byte> picture,
               std::span<const std::byte> depth = {});

  const std::string source_name_;
  std::array<Slot, kProducts> slots_;
  std::atomic<std::uint64_t> number_{0};  // written by infer only
  Heartbeat heartbeat_;

  std::mutex mutex_;  // guards what follows
  std::condition_variable offered_;
  FrameCopy incoming_;
  std::size_t needed_colour_ = 0;
  std::size_t needed_depth_ = 0;
  bool stopping_ = false;

  FrameCopy working_;  // from here on: encode thread only
  JpegWriter colour_jpeg_{kStreamedQuality};
  JpegWriter depth_jpeg_{kStreamedQuality};
  JpegWriter side_jpeg_{kStreamedQuality};
  DepthColour colours_;
  bool has_range_ = false;
  RgbPicture colour_picture_;
  RgbPicture depth_picture_;
  RgbPicture side_picture_;
  std::vector<std::byte> png_;

  std::thread thread_;
};

}  // namespace lcdm
