// Less work before it is forced upon us: a smaller network (where there is one), then rest between
// frames, when the board is hot or the network is slower than depth is wanted. Pure: time comes in
// as a number.
#pragma once

#include <cstdint>
#include <limits>

namespace lcdm {

// How much work goes into depth.
enum class Effort : std::uint8_t {
  kFull,
  kSmallNetwork,      // the smaller network, prepared at the start
  kSmallNetworkRest,  // and after each frame a rest as long as its inference took
  kRest,              // instead of both where there is no smaller network: the full one and rests
};

const char* to_string(Effort effort);
bool takes_small_network(Effort effort);
bool rests(Effort effort);

struct LoadFacts {
  std::int64_t now_ns = 0;  // CLOCK_MONOTONIC
  bool throttled = false;   // the system holds the processor back
  double headroom_celsius = std::numeric_limits<double>::infinity();  // to the nearest limit
  std::int64_t inference_ns = -1;  // of a typical frame lately; negative: none yet
  bool has_small_network = true;   // a smaller network is prepared, for the camera there is now
};

// Belongs to one thread: main.
class DegradeLadder {
 public:
  // `least_rate`: depths a second that are wanted; 0: as many as come.
  explicit DegradeLadder(double least_rate) : least_rate_(least_rate) {}

  // One look, several times a second; gives the effort from now on.
  Effort judge(const LoadFacts& facts);

  // Why the effort is lowered; empty at full effort.
  const char* reason() const { return reason_; }
  std::uint64_t lowered() const { return lowered_; }
  std::uint64_t raised() const { return raised_; }

 private:
  void follow_network(bool has_small);
  const char* strain(const LoadFacts& facts) const;
  bool at_ease(const LoadFacts& facts) const;
  void lower(const LoadFacts& facts, const char* why);
  void raise(std::int64_t now_ns);

  const double least_rate_;
  Effort effort_ = Effort::kFull;
  const char* reason_ = "";
  std::int64_t strained_since_ns_ = -1;
  std::int64_t at_ease_since_ns_ = -1;
  std::int64_t last_lowered_ns_ = -1;
  std::int64_t last_raised_ns_ = -1;
  std::int64_t hold_ns_ = 0;  // how long ease must last
  std::uint64_t lowered_ = 0;
  std::uint64_t raised_ = 0;
};

}  // namespace lcdm
