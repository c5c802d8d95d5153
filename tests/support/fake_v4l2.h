// A V4L2 camera that does not exist: umockdev answers the driver's real system calls. Run the
// program under `umockdev-wrapper`.
#pragma once

#include <cstdint>
#include <functional>
#include <linux/videodev2.h>
#include <memory>
#include <optional>
#include <sys/time.h>
#include <vector>

namespace lcdm::test {

// True when this process runs under umockdev-wrapper.
bool umockdev_active();

class FakeV4l2 {
 public:
  // What the fake driver does when a frame is asked for.
  enum class Answer {
    kFrame,       // delivers one
    kNothing,     // EAGAIN
    kIoError,     // EIO
    kGone,        // ENODEV
    kLostFrame,   // EAGAIN; the sequence passes over a frame
    kErrorFlag,   // a frame with V4L2_BUF_FLAG_ERROR
    kShortFrame,  // one byte
    kHugeFrame,   // bytesused beyond the buffer
    kWildIndex,   // a buffer that does not exist
    kSameAgain,   // the buffer it delivered last, given back or not
  };
  // A size that the driver lists for its format, at one rate.
  struct Size {
    std::uint32_t width = 0;
    std::uint32_t height = 0;
    std::uint32_t frames_per_second = 0;
  };
  // A range of sizes, whose rate is what of that many pixels a second comes out. Sizes off the grid
  // have none.
  struct Range {
    Size least;
    Size most;
    std::uint32_t step = 1;
    std::uint32_t pixels_per_second = 0;
  };
  struct Behaviour {
    std::uint32_t fourcc = V4L2_PIX_FMT_YUYV;
    std::uint32_t raw_formats = 0;  // listed before that one, which we do not read
    std::vector<Size> sizes;        // empty: the driver lists none
    std::optional<Range> range;     // in place of `sizes`
    std::uint32_t planes = 1;       // of memory, that a multi-planar driver uses
    std::uint32_t data_offset = 0;  // bytes before the picture in a multi-planar driver's buffer
    std::uint32_t rate = 25;        // that it makes of every rate asked for
    std::uint32_t stamp_flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_EOF;
    std::optional<timeval> stamp;         // of every frame; empty: the moment it is delivered
    std::vector<std::uint32_t> controls;  // that the camera has
    int most_of_a_control = 1'000'000;    // larger values become this
    bool on_usb = false;  // as /dev/bus/usb/001/004, serial number F00D, USB 3.2 camera at 480 Mb/s
    std::uint32_t width = 64;
    std::uint32_t height = 48;
    std::uint32_t row_padding = 0;  // bytes behind each row
    std::uint32_t most_buffers = 8;
    std::uint32_t capabilities = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
    std::uint32_t first_sequence = 0;
    bool shares_buffers = true;  // as dma-bufs; here descriptors of the memory of all of them
    // The n-th request for a frame since the device was made, from 0.
    std::function<Answer(int)> answer = [](int) { return Answer::kFrame; };
    // What is in the frame of that sequence, which is delivered now; at most a buffer's size. Null:
    // every byte is the sequence's low 8 bits.
    std::function<std::vector<std::uint8_t>(std::uint32_t)> contents;
    // The errno with which an ioctl fails before anything else; 0: it does not.
    std::function<int(unsigned)> refuse = [](unsigned) { return 0; };
  };

  // Makes /dev/video0 appear in this process, and kLink to it.
  explicit FakeV4l2(const Behaviour& behaviour);
  ~FakeV4l2();
  FakeV4l2(const FakeV4l2&) = delete;
  FakeV4l2& operator=(const FakeV4l2&) = delete;

  static constexpr const char* kPath = "/dev/video0";
  static constexpr const char* kLink = "/dev/v4l/by-path/usb-0:1:1.0-video-index0";

  // From now on behaves differently; the node stays.
  void set_behaviour(const Behaviour& behaviour);
  int buffers_with_driver() const;
  // The value a control was last set to; empty: never.
  std::optional<int> control(std::uint32_t id) const;
  // The period in seconds that was last asked for; empty: never.
  std::optional<v4l2_fract> period_asked() const;
  // The signal at the camera's input changes: an event is pending for those who subscribed to it.
  void change_source();
  // The kernel's news about the device: "add" or "remove". The node stays.
  void announce(const char* action);
  int usb_resets() const;
  // From now on only the superuser may open the node.
  void close_to_everybody();

  static constexpr const char* kUsbPath = "/dev/bus/usb/001/004";

  struct State;  // defined in the .cpp: the fake driver's side

 private:
  std::unique_ptr<State> state_;
};

}  // namespace lcdm::test
