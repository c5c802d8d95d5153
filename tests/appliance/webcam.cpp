// A USB webcam of software. In the guest the kernel's gadgetfs and simulated bus carry it, and the
// kernel's own uvcvideo drives it like any webcam: YUYV, 160x120, 10 frames/s, UVC 1.0 over a bulk
// endpoint (the simulated bus has no isochronous ones).
//
//   webcam FOLDER      until SIGTERM, which unplugs it; FOLDER: where gadgetfs is mounted
//
// The process answers the host's questions, its child sends the frames. A child that is stopped
// (SIGSTOP) is a camera whose firmware hangs: nothing but a reset of its port gives it a new one.
#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fcntl.h>
#include <filesystem>
#include <initializer_list>
#include <linux/usb/ch9.h>
#include <linux/usb/gadgetfs.h>
#include <linux/usb/video.h>
#include <poll.h>
#include <string>
#include <string_view>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>
#include <vector>

namespace {

using Bytes = std::vector<std::uint8_t>;

constexpr int kWidth = 160;
constexpr int kHeight = 120;
constexpr std::uint32_t kFrameBytes = kWidth * kHeight * 2;
constexpr std::uint32_t kInterval = 1'000'000;  // between frames, in 100 ns
constexpr std::uint32_t kPayloadBytes = 8192;   // of one transfer, header and all
constexpr std::uint8_t kEndpoint = 0x81;        // the first, towards the host
constexpr const char* kEndpointFile = "ep1in-bulk";
constexpr std::array<std::string_view, 4> kTexts = {"", "LCDM", "Test webcam", "webcam-1"};

[[noreturn]] void fail(const std::string& what) {
  std::fprintf(stderr, "webcam: %s: %s\n", what.c_str(), std::strerror(errno));
  std::exit(1);
}

Bytes little_endian(std::uint32_t value, int bytes) {
  Bytes result;
  for (int i = 0; i < bytes; ++i) result.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
  return result;
}
Bytes u16(std::uint32_t value) { return little_endian(value, 2); }
Bytes u32(std::uint32_t value) { return little_endian(value, 4); }

Bytes join(std::initializer_list<Bytes> parts) {
  Bytes all;
  for (const Bytes& part : parts) all.insert(all.end(), part.begin(), part.end());
  return all;
}

// A descriptor begins with its length.
Bytes descriptor(std::initializer_list<Bytes> parts) {
  const Bytes body = join(parts);
  return join({{static_cast<std::uint8_t>(body.size() + 1)}, body});
}

Bytes endpoint(std::uint32_t packet_bytes) {
  return descriptor({{USB_DT_ENDPOINT, kEndpoint, USB_ENDPOINT_XFER_BULK}, u16(packet_bytes), {0}});
}

// UVC 1.0, section 3.7: a sensor, and the stream that it becomes.
Bytes control_interface() {
  const Bytes camera = descriptor({{0x24, UVC_VC_INPUT_TERMINAL, 1},
                                   u16(UVC_ITT_CAMERA),
                                   {0, 0, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0}});
  const Bytes output =
      descriptor({{0x24, UVC_VC_OUTPUT_TERMINAL, 2}, u16(UVC_TT_STREAMING), {0, 1, 0}});
  const auto bytes = static_cast<std::uint32_t>(13 + camera.size() + output.size());
  return join(
      {descriptor({{USB_DT_INTERFACE, 0, 0, 0, USB_CLASS_VIDEO, UVC_SC_VIDEOCONTROL, 0, 0}}),
       descriptor({{0x24, UVC_VC_HEADER}, u16(0x0100), u16(bytes), u32(1'000'000), {1, 1}}), camera,
       output});
}

// UVC 1.0, section 3.9: one format, one size.
Bytes streaming_interface(std::uint32_t packet_bytes) {
  const Bytes format =
      descriptor({{0x24, UVC_VS_FORMAT_UNCOMPRESSED, 1, 1},
                  {'Y', 'U', 'Y', '2', 0, 0, 0x10, 0, 0x80, 0, 0, 0xAA, 0, 0x38, 0x9B, 0x71},
                  {16, 1, 0, 0, 0, 0}});
  const std::uint32_t bits = kFrameBytes * 8 * 10;
  const Bytes frame = descriptor({{0x24, UVC_VS_FRAME_UNCOMPRESSED, 1, 0},
                                  u16(kWidth),
                                  u16(kHeight),
                                  u32(bits),
                                  u32(bits),
                                  u32(kFrameBytes),
                                  u32(kInterval),
                                  {1},
                                  u32(kInterval)});
  const auto bytes = static_cast<std::uint32_t>(14 + format.size() + frame.size());
  return join(
      {descriptor({{USB_DT_INTERFACE, 1, 0, 1, USB_CLASS_VIDEO, UVC_SC_VIDEOSTREAMING, 0, 0}}),
       descriptor({{0x24, UVC_VS_INPUT_HEADER, 1}, u16(bytes), {kEndpoint, 0, 2, 0, 0, 0, 1, 0}}),
       format, frame, endpoint(packet_bytes)});
}

Bytes configuration(std::uint32_t packet_bytes) {
  const Bytes body = join({descriptor({{USB_DT_INTERFACE_ASSOCIATION, 0, 2, USB_CLASS_VIDEO,
                                        UVC_SC_VIDEO_INTERFACE_COLLECTION, 0, 0}}),
                           control_interface(), streaming_interface(packet_bytes)});
  const auto bytes = static_cast<std::uint32_t>(USB_DT_CONFIG_SIZE + body.size());
  return join({descriptor({{USB_DT_CONFIG}, u16(bytes), {2, 1, 0, USB_CONFIG_ATT_ONE, 50}}), body});
}

// What gadgetfs wants first: the configuration at full and at high speed, and the device.
Bytes device() {
  return join({u32(0), configuration(64), configuration(512),
               descriptor({{USB_DT_DEVICE},
                           u16(0x0200),
                           {USB_CLASS_MISC, 2, 1, 64},
                           u16(0x1d6b),
                           u16(0x0104),
                           u16(0x0100),
                           {1, 2, 3, 1}})});
}

// UVC 1.0, section 4.3.1.1: the only stream there is, whatever is asked for.
Bytes probe() {
  return join({u16(0),
               {1, 1},
               u32(kInterval),
               u16(0),
               u16(0),
               u16(0),
               u16(0),
               u16(0),
               u32(kFrameBytes),
               u32(kPayloadBytes)});
}

Bytes text(std::uint8_t number) {
  if (number == 0) return descriptor({{USB_DT_STRING}, u16(0x0409)});
  Bytes letters;
  for (const char letter : kTexts.at(number)) {
    letters.push_back(static_cast<std::uint8_t>(letter));
    letters.push_back(0);
  }
  return descriptor({{USB_DT_STRING}, letters});
}

// A bright square goes across a ramp.
Bytes picture(int number) {
  Bytes bytes(kFrameBytes, 128);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const bool square = std::abs(x - number * 4 % kWidth) < 16 && std::abs(y - 60) < 16;
      bytes[static_cast<std::size_t>(y * kWidth + x) * 2] =
          static_cast<std::uint8_t>(square ? 235 : 16 + y);
    }
  }
  return bytes;
}

// UVC 1.0, section 2.4.3.3: each transfer has a header of two bytes; its first bit is another with
// every frame, its second tells the last part.
void send_frame(int endpoint, int number) {
  const Bytes frame = picture(number);
  constexpr std::size_t kPart = kPayloadBytes - 2;
  for (std::size_t first = 0; first < frame.size(); first += kPart) {
    const std::size_t last = std::min(first + kPart, frame.size());
    const int flags =
        UVC_STREAM_EOH | (number & UVC_STREAM_FID) | (last == frame.size() ? UVC_STREAM_EOF : 0);
    Bytes payload = {2, static_cast<std::uint8_t>(flags)};
    payload.insert(payload.end(), frame.begin() + static_cast<std::ptrdiff_t>(first),
                   frame.begin() + static_cast<std::ptrdiff_t>(last));
    if (write(endpoint, payload.data(), payload.size()) < 0) fail("a frame");
  }
}

[[noreturn]] void send_frames(int endpoint) {
  for (int number = 0;; ++number) {
    send_frame(endpoint, number);  // waits while nobody takes them
    std::this_thread::sleep_for(std::chrono::nanoseconds{kInterval * 100LL});
  }
}

class Webcam {
 public:
  explicit Webcam(const std::filesystem::path& folder) : folder_(folder) {
    // The controller's file is the only one before there is a device.
    const auto file = std::filesystem::directory_iterator(folder)->path();
    control_ = open(file.c_str(), O_RDWR | O_CLOEXEC);
    const Bytes description = device();
    if (control_ < 0 || write(control_, description.data(), description.size()) < 0) fail(file);
  }

  // Until SIGTERM. The child ends first: gadgetfs does not survive a device that goes while
  // something is being written to it.
  void serve() {
    sigset_t during_wait;
    sigset_t term;
    sigemptyset(&term);
    sigaddset(&term, SIGTERM);
    sigprocmask(SIG_BLOCK, &term, &during_wait);
    signal(SIGTERM, [](int) {});
    pollfd request{control_, POLLIN, 0};
    while (ppoll(&request, 1, nullptr, &during_wait) >= 0) {
      usb_gadgetfs_event event{};
      if (read(control_, &event, sizeof(event)) < 0) fail("control");
      if (event.type == GADGETFS_SETUP) answer(event.u.setup);
      if (event.type == GADGETFS_DISCONNECT) stop();  // also what a reset of the port is
    }
    stop();
  }

 private:
  void answer(const usb_ctrlrequest& request) {
    const bool standard = (request.bRequestType & USB_TYPE_MASK) == USB_TYPE_STANDARD;
    const bool known = standard ? answer_standard(request) : answer_stream(request);
    if (known) return;
    // Data in the wrong direction is a refusal (stall).
    char none = 0;
    const bool in = (request.bRequestType & USB_DIR_IN) != 0;
    static_cast<void>(in ? read(control_, &none, 0) : write(control_, &none, 0));
  }

  bool answer_standard(const usb_ctrlrequest& request) {
    switch (request.bRequest) {
      case USB_REQ_SET_CONFIGURATION:
        stop();
        if (request.wValue != 0) start();
        return accept();
      case USB_REQ_SET_INTERFACE:
        return accept();
      case USB_REQ_GET_DESCRIPTOR:
        if (request.wValue >> 8 != USB_DT_STRING || (request.wValue & 0xFF) >= kTexts.size())
          return false;
        return reply(text(static_cast<std::uint8_t>(request.wValue)), request.wLength);
      default:
        return false;
    }
  }

  bool answer_stream(const usb_ctrlrequest& request) {
    const int control = request.wValue >> 8;
    const bool streaming = (request.wIndex & 0xFF) == 1;
    if (!streaming || (control != UVC_VS_PROBE_CONTROL && control != UVC_VS_COMMIT_CONTROL))
      return false;
    switch (request.bRequest) {
      case UVC_SET_CUR: {
        Bytes wanted(request.wLength);
        return read(control_, wanted.data(), wanted.size()) >= 0;
      }
      case UVC_GET_LEN:
        return reply(u16(static_cast<std::uint32_t>(probe().size())), request.wLength);
      case UVC_GET_INFO:
        return reply({3}, request.wLength);  // may be read and set
      default:
        return reply(probe(), request.wLength);
    }
  }

  bool accept() {
    char none = 0;
    return read(control_, &none, 0) >= 0;
  }
  bool reply(Bytes bytes, std::size_t most) {
    bytes.resize(std::min(bytes.size(), most));
    return write(control_, bytes.data(), bytes.size()) >= 0;
  }

  void start() {
    const int stream = open((folder_ / kEndpointFile).c_str(), O_RDWR);
    const Bytes description = join({u32(1), endpoint(64), endpoint(512)});
    if (stream < 0 || write(stream, description.data(), description.size()) < 0)
      fail(kEndpointFile);
    child_ = fork();
    if (child_ == 0) send_frames(stream);
    close(stream);
  }
  void stop() {
    if (child_ <= 0) return;
    kill(child_, SIGKILL);
    waitpid(child_, nullptr, 0);
    child_ = 0;
  }

  std::filesystem::path folder_;
  int control_ = -1;
  pid_t child_ = 0;
};

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "webcam: give the folder where gadgetfs is mounted\n");
    return 2;
  }
  Webcam(argv[1]).serve();
}
