// A V4L2 camera that does not exist: umockdev answers the driver's real system calls. Run the
// program under `umockdev-wrapper`.
#pragma once

#include <cstdint>
#include <functional>
#include <linux/videodev2.h>
#include <memory>

namespace lcdm::test {

// True when this process runs under umockdev-wrapper.
bool umockdev_active();

class FakeV4l2 {
 public:
  // What the fake driver does when a frame is asked for.
  enum class Answer {
    kFrame,       // delivers: every byte is the sequence's low 8 bits
    kNothing,     // EAGAIN
    kIoError,     // EIO
    kGone,        // ENODEV
    kErrorFlag,   // a frame with V4L2_BUF_FLAG_ERROR
    kShortFrame,  // one byte
    kHugeFrame,   // bytesused beyond the buffer
    kWildIndex,   // a buffer that does not exist
  };
  struct Behaviour {
    std::uint32_t fourcc = V4L2_PIX_FMT_YUYV;
    std::uint32_t width = 64;
    std::uint32_t height = 48;
    std::uint32_t row_padding = 0;  // bytes behind each row
    std::uint32_t most_buffers = 8;
    std::uint32_t capabilities = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
    std::uint32_t first_sequence = 0;
    // The n-th request for a frame since the device was made, from 0.
    std::function<Answer(int)> answer = [](int) { return Answer::kFrame; };
  };

  // Makes /dev/video0 appear in this process.
  explicit FakeV4l2(const Behaviour& behaviour);
  ~FakeV4l2();
  FakeV4l2(const FakeV4l2&) = delete;
  FakeV4l2& operator=(const FakeV4l2&) = delete;

  static constexpr const char* kPath = "/dev/video0";

  // From now on behaves differently; the node stays.
  void set_behaviour(const Behaviour& behaviour);
  int buffers_with_driver() const;

  struct State;  // defined in the .cpp: the fake driver's side

 private:
  std::unique_ptr<State> state_;
};

}  // namespace lcdm::test
