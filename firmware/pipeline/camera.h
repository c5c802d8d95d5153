// What every source of frames is: a V4L2 device, a rendered scene, a file, a recording.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>

#include "firmware/base/status.h"
#include "firmware/buffer/frame.h"
#include "firmware/vision/camera_model.h"

namespace lcdm {

// How the picture is made, for cameras that can be told; what they cannot do they say in info().
struct ImageControls {
  double exposure_ms = 0;        // 0: automatic
  double gain = -1;              // in the camera's own units; negative: automatic
  int white_balance_kelvin = 0;  // 0: automatic
  int power_line_hz = 0;         // 50 or 60, against flicker; 0: automatic where there is that
};

// What we would like; a camera takes the nearest it can do and says so in format() and info().
struct CaptureRequest {
  int width = 640;
  int height = 480;
  float frames_per_second = 30;
  float assumed_field_of_view = 65;  // degrees, horizontal; for sources that know no intrinsics
  ImageControls controls;
  std::optional<PixelFormat> format{};  // of a device that has several; none: the cheapest for us
};

// The moment of a frame that its sensor_ns means.
enum class StampSource : std::uint8_t {
  kArrival,          // we took it: the source has no stamp of its own on our clock
  kEndOfFrame,       // the kernel had received the whole frame
  kStartOfExposure,  // the sensor began to expose, or nearest to it that the source knows
};

const char* to_string(StampSource stamp);

struct CameraInfo {
  std::string uri;          // what reopens this source
  std::string description;  // one line for a person: name, format, rate
  float frames_per_second = 0;
  StampSource stamp = StampSource::kArrival;
  std::string usb{};  // the device node of the USB device it is, /dev/bus/usb/001/004; empty: none
};

// One dequeued buffer: `view` stays valid until requeue(index) or stop().
struct CapturedFrame {
  int index = -1;
  FrameView view;
  // What view.meta.sensor_ns means: as info() said, unless the source's stamps have proved useless.
  StampSource stamp = StampSource::kArrival;
};

// Owns its buffers. Used from one thread at a time: configure and info where it is opened,
// everything else on the capture thread. Life cycle: configure -> start -> (dequeue, requeue)* ->
// stop, and again from start or configure; from configure after close. Destruction closes. Between
// start and stop nothing allocates.
class Camera {
 public:
  virtual ~Camera() = default;

  // Opens the source. On error nothing stays open, and the text says what, where, and the cure.
  virtual Status configure(const CaptureRequest& request) = 0;

  // Valid after configure. Of info(), `uri` always is, and `usb` also after one that failed
  // although the camera was found: so that its port can be reset.
  virtual const FrameFormat& format() const = 0;
  virtual CameraModel model() const = 0;
  virtual CameraInfo info() const = 0;
  virtual int buffer_count() const = 0;
  // A name for a frame's output files: the source file's stem, else the zero-padded sequence.
  virtual std::string frame_name(std::uint64_t sequence) const;

  virtual Status start() = 0;
  // Waits at most `timeout` for a frame. kTimeout: nothing yet. kCorrupt: one frame lost, go on.
  // kUnavailable: the source changed its format; configure again. kDeviceGone: it left; configure
  // again once it is back. kIoError: stop and start, or configure again. kEndOfStream: a finite
  // source is at its end.
  virtual Result<CapturedFrame> dequeue(std::chrono::milliseconds timeout) = 0;
  // Gives a dequeued buffer back for reuse.
  virtual Status requeue(int index) = 0;
  virtual void stop() = 0;
  // Stops, and lets go of the device: none of it stays open until the next configure. A device that
  // leaves while it is open comes back under another name.
  virtual void close() { stop(); }
};

}  // namespace lcdm
