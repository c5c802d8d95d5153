// What every source of frames is: a V4L2 device, a rendered scene, a file, a recording.
#pragma once

#include <chrono>
#include <string>

#include "firmware/base/status.h"
#include "firmware/buffer/frame.h"
#include "firmware/vision/camera_model.h"

namespace lcdm {

// What we would like; a camera takes the nearest it can do and says so in format() and info().
struct CaptureRequest {
  int width = 640;
  int height = 480;
  float frames_per_second = 30;
  float assumed_field_of_view = 65;  // degrees, horizontal; for sources that know no intrinsics
};

struct CameraInfo {
  std::string uri;          // what reopens this source
  std::string description;  // one line for a person: name, format, rate
  float frames_per_second = 0;
};

// One dequeued buffer: `view` stays valid until requeue(index) or stop().
struct CapturedFrame {
  int index = -1;
  FrameView view;
};

// Owns its buffers. Used from one thread at a time: configure and info where it is opened,
// everything else on the capture thread. Life cycle: configure -> start -> (dequeue, requeue)* ->
// stop, and again from configure; destruction stops. Between start and stop nothing allocates.
class Camera {
 public:
  virtual ~Camera() = default;

  // Opens the source. On error nothing stays open, and the text says what, where, and the cure.
  virtual Status configure(const CaptureRequest& request) = 0;

  // Valid after configure.
  virtual const FrameFormat& format() const = 0;
  virtual CameraModel model() const = 0;
  virtual CameraInfo info() const = 0;
  virtual int buffer_count() const = 0;
  // A name for a frame's output files: the source file's stem, else the zero-padded sequence.
  virtual std::string frame_name(std::uint64_t sequence) const;

  virtual Status start() = 0;
  // Waits at most `timeout` for a frame. kTimeout: nothing yet. kCorrupt: one frame lost, go on.
  // kDeviceGone, kIoError: stop, then configure again. kEndOfStream: a finite source is at its end.
  virtual Result<CapturedFrame> dequeue(std::chrono::milliseconds timeout) = 0;
  // Gives a dequeued buffer back for reuse.
  virtual Status requeue(int index) = 0;
  virtual void stop() = 0;
};

}  // namespace lcdm
