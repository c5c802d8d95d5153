// The kernel's queue of capture buffers: format, rate, mapping, queueing; single- and multi-planar
// behind one face.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "drivers/v4l2/device.h"
#include "drivers/v4l2/formats.h"
#include "firmware/buffer/frame.h"
#include "firmware/pipeline/camera.h"

namespace lcdm {

// A buffer that the driver has filled. Checked: the index is one of ours, the bytes lie inside it.
struct V4l2Filled {
  int index = -1;
  bool ours = false;  // the driver did not have it: it is still ours, and now part of two frames
  const std::uint8_t* data = nullptr;
  std::size_t bytes = 0;
  std::uint32_t flags = 0;     // V4L2_BUF_FLAG_...
  std::uint32_t sequence = 0;  // the driver's count, 32 bits
  std::int64_t stamp_ns = 0;   // CLOCK_MONOTONIC; of the moment that stamp() names
};

// Borrows the device, which must stay open while buffers are mapped. Threads: as Camera.
class V4l2Queue {
 public:
  explicit V4l2Queue(const V4l2Device& device) : device_(device) {}
  ~V4l2Queue() { unmap(); }
  V4l2Queue(const V4l2Queue&) = delete;
  V4l2Queue& operator=(const V4l2Queue&) = delete;

  // Asks for a mode and gives what the driver made of it, if that makes sense.
  Result<FrameFormat> set_format(const V4l2Choice& choice);
  // Frames/s that the driver says it will keep; 0: it does not say.
  float set_rate(float frames_per_second) const;
  // Reserves and maps the buffers.
  Status map();
  void unmap();
  // A mapped buffer as a dma-buf, which the caller closes. kUnsupported: the driver cannot.
  Result<int> export_buffer(int index) const;

  int size() const { return static_cast<int>(buffers_.size()); }
  // What the stamps of frames mean: kArrival from the first useless one to the next `map`.
  StampSource stamp() const { return stamp_; }

  // Gives every buffer to the driver and starts it. `stop` takes all back, also after a start that
  // failed.
  Status start();
  void stop();

  Status enqueue(int index);
  // 0, or the errno: EAGAIN when there is none. EBADMSG: what the driver answered makes no sense.
  int dequeue(V4l2Filled& filled);

 private:
  struct Mapping {
    void* memory = nullptr;
    std::size_t length = 0;
    bool with_driver = false;
  };
  // The driver's view of one buffer; `plane` is used by multi-planar drivers.
  struct Slot {
    v4l2_buffer buffer{};
    v4l2_plane plane{};
  };

  void prepare(Slot& slot, std::uint32_t index) const;
  std::int64_t stamp_of(const v4l2_buffer& buffer);
  Status map_one(std::uint32_t index);

  const V4l2Device& device_;
  std::vector<Mapping> buffers_;
  StampSource stamp_ = StampSource::kArrival;
};

}  // namespace lcdm
