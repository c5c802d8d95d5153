// The camera of the soak: JPEGs of a moving picture at a steady rate from the scripted kernel, and
// every way to fail that the kernel's side has. Counts what it gave.
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <random>
#include <vector>

#include "tests/support/fake_v4l2.h"

namespace lcdm::test {

// Moods and counts may be used from any thread; the rest runs on the one that answers ioctls.
class SoakCamera {
 public:
  enum class Mood : std::uint8_t {
    kWell,
    kLosesFrames,   // some, as their sequence shows
    kMarksFrames,   // some, as damaged
    kCutsFrames,    // all of them: their end is missing
    kFlipsBits,     // of every frame
    kSilent,        // gives nothing
    kHangs,         // gives nothing until its stream is started again, which cures it
    kFailsStreams,  // EIO for every frame asked for and for every start of the stream
    kVanished,      // ENODEV to everything, of which udev is told nothing
  };
  // Frames that went to the program, as the kernel sees it.
  struct Account {
    std::uint64_t delivered = 0;  // buffers handed over, whatever was in them
    std::uint64_t lost = 0;       // of which the delivered ones' sequence tells
  };

  explicit SoakCamera(std::uint32_t seed);

  void set_mood(Mood mood) { mood_ = mood; }
  // The camera leaves, and is back; udev is told. Its node stays: umockdev loses a descriptor of
  // the program's at every opening of one that is not there.
  void unplug();
  void plug_in();
  Account account() const { return {delivered_, lost_}; }

 private:
  using Bytes = std::vector<std::uint8_t>;

  FakeV4l2::Behaviour behaviour();
  FakeV4l2::Answer answer();
  Bytes contents();
  int refuse(unsigned request);
  std::size_t below(std::size_t end);
  void flip_bits(Bytes& jpeg);

  std::mt19937 random_;
  const std::vector<Bytes> pictures_;
  std::size_t shown_ = 0;
  std::chrono::steady_clock::time_point due_;  // the next frame
  bool stream_is_new_ = true;                  // has given no frame yet
  std::uint64_t passed_over_ = 0;              // lost since the last delivered one
  std::atomic<Mood> mood_{Mood::kWell};
  std::atomic<std::uint64_t> delivered_{0};
  std::atomic<std::uint64_t> lost_{0};
  FakeV4l2 device_;  // last: it asks the others
};

}  // namespace lcdm::test
