#include "tests/app/soak_camera.h"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstddef>
#include <span>
#include <thread>

#include "drivers/codec/codec.h"
#include "firmware/base/check.h"

namespace lcdm::test {
namespace {

using Answer = FakeV4l2::Answer;
using Mood = SoakCamera::Mood;
using std::chrono::milliseconds;
using std::chrono::steady_clock;

constexpr int kWidth = 160;
constexpr int kHeight = 120;
constexpr int kPictures = 8;
constexpr int kRate = 30;
constexpr std::chrono::nanoseconds kPeriod{1'000'000'000 / kRate};
// The longest that a request for a frame is held back, in place of the waiting that poll() would
// do.
constexpr milliseconds kLongestWait{20};
constexpr std::size_t kLeastFlips = 8;  // of bits in a frame
constexpr std::size_t kMostFlips = 24;

// Waves, so that every block has something to decode; each number is shifted a little.
std::vector<std::uint8_t> rgb_of(int number) {
  std::vector<std::uint8_t> rgb;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      for (const int period : {11, 23, 37}) {
        const double wave = std::sin((x + 3 * number) * 6.28 / period + y * 0.2);
        rgb.push_back(static_cast<std::uint8_t>(128 + 100 * wave));
      }
    }
  }
  return rgb;
}

std::vector<std::vector<std::uint8_t>> encoded_pictures() {
  constexpr FrameFormat kFormat{PixelFormat::kRgb24, kWidth, kHeight, kWidth * 3};
  JpegEncoder encoder;
  LCDM_CHECK(encoder.prepare(kFormat, 80));
  std::vector<std::vector<std::uint8_t>> all;
  for (int i = 0; i < kPictures; ++i) {
    const std::vector<std::uint8_t> rgb = rgb_of(i);
    // No longer than the driver's buffers: it asks for a byte a pixel.
    std::vector<std::uint8_t> jpeg(kWidth * kHeight);
    const auto size = encoder.encode({kFormat, {}, rgb.data(), rgb.size()},
                                     std::as_writable_bytes(std::span(jpeg)));
    LCDM_CHECK(size);
    jpeg.resize(*size);
    all.push_back(jpeg);
  }
  return all;
}

}  // namespace

SoakCamera::SoakCamera(std::uint32_t seed)
    : random_(seed), pictures_(encoded_pictures()), device_(behaviour()) {}

void SoakCamera::unplug() {
  set_mood(Mood::kVanished);
  device_.announce("remove");
}

void SoakCamera::plug_in() {
  set_mood(Mood::kWell);
  device_.announce("add");
}

FakeV4l2::Behaviour SoakCamera::behaviour() {
  FakeV4l2::Behaviour scripted;
  scripted.fourcc = V4L2_PIX_FMT_MJPEG;
  scripted.width = kWidth;
  scripted.height = kHeight;
  scripted.rate = kRate;
  scripted.on_usb = true;
  scripted.answer = [this](int) { return answer(); };
  scripted.contents = [this](std::uint32_t) { return contents(); };
  scripted.refuse = [this](unsigned request) { return refuse(request); };
  return scripted;
}

// A request for a frame, held back until one is due.
Answer SoakCamera::answer() {
  const Mood mood = mood_;
  if (mood == Mood::kFailsStreams) return Answer::kIoError;
  const auto now = steady_clock::now();
  if (due_ + kPeriod < now) due_ = now;  // what nobody asked for is not made up for
  std::this_thread::sleep_until(std::min(due_, now + kLongestWait));
  if (mood == Mood::kSilent || mood == Mood::kHangs || due_ > steady_clock::now()) {
    return Answer::kNothing;
  }
  due_ += kPeriod;
  const bool chosen = below(2) == 0;
  if (mood == Mood::kMarksFrames && chosen) return Answer::kErrorFlag;
  if (mood != Mood::kLosesFrames || !chosen) return Answer::kFrame;
  ++passed_over_;
  return Answer::kLostFrame;
}

// The next frame, which is delivered now.
SoakCamera::Bytes SoakCamera::contents() {
  ++delivered_;
  if (!stream_is_new_) lost_ += passed_over_;  // a stream is counted from its first frame
  stream_is_new_ = false;
  passed_over_ = 0;
  Bytes jpeg = pictures_[shown_++ % pictures_.size()];
  const Mood mood = mood_;
  if (mood == Mood::kCutsFrames) jpeg.resize(2 + below(jpeg.size() - 3));
  if (mood == Mood::kFlipsBits) flip_bits(jpeg);
  return jpeg;
}

// Anywhere behind the first marker.
void SoakCamera::flip_bits(Bytes& jpeg) {
  for (std::size_t flips = kLeastFlips + below(kMostFlips - kLeastFlips); flips > 0; --flips) {
    jpeg[2 + below(jpeg.size() - 2)] ^= static_cast<std::uint8_t>(1U << below(8));
  }
}

int SoakCamera::refuse(unsigned request) {
  if (mood_ == Mood::kVanished) return ENODEV;
  if (request != VIDIOC_STREAMON) return 0;
  if (mood_ == Mood::kFailsStreams) return EIO;
  stream_is_new_ = true;
  passed_over_ = 0;
  Mood hanging = Mood::kHangs;
  mood_.compare_exchange_strong(hanging, Mood::kWell);
  return 0;
}

std::size_t SoakCamera::below(std::size_t end) {
  return std::uniform_int_distribution<std::size_t>(0, end - 1)(random_);
}

}  // namespace lcdm::test
