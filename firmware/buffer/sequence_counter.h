// A driver's 32-bit frame count, continued past its wrap.
#pragma once

#include <cstdint>

namespace lcdm {

class SequenceCounter {
 public:
  // The stream starts anew: the next frame is number 0.
  void reset() { *this = {}; }

  // Our number of the frame that the driver calls `count`. A driver that does not count, or counts
  // backwards, is counted for.
  std::uint64_t next(std::uint32_t count) {
    if (!first_) {
      const std::uint32_t step = count - last_;
      number_ += step == 0 || step > 0x7FFF'FFFF ? 1 : step;
    }
    first_ = false;
    last_ = count;
    return number_;
  }

 private:
  bool first_ = true;
  std::uint32_t last_ = 0;
  std::uint64_t number_ = 0;
};

}  // namespace lcdm
