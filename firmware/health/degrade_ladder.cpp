#include "firmware/health/degrade_ladder.h"

#include <algorithm>

namespace lcdm {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;
// Strain must last, so that one slow frame or one reading changes nothing.
constexpr std::int64_t kStrainNs = 3 * kSecond;
// What a step gained shows only after this long: a board cools slowly.
constexpr std::int64_t kSettleNs = 15 * kSecond;
// Ease must last this long before more work is tried; twice as long, up to the most, each time
// the last try failed soon.
constexpr std::int64_t kFirstHoldNs = 30 * kSecond;
constexpr std::int64_t kMostHoldNs = 600 * kSecond;
constexpr std::int64_t kFailedSoonNs = 300 * kSecond;
// Degrees to the limit: strained below the first, at ease above the second.
constexpr double kHotHeadroom = 5;
constexpr double kCoolHeadroom = 10;

constexpr const char* kThrottled = "the processor is throttled";
constexpr const char* kHot = "the board is hot";
constexpr const char* kSlow = "the network is slower than service.least_rate";

}  // namespace

const char* to_string(Effort effort) {
  switch (effort) {
    case Effort::kFull:
      return "full network";
    case Effort::kSmallNetwork:
      return "smaller network";
    case Effort::kSmallNetworkRest:
      return "smaller network with rests";
    case Effort::kRest:
      return "full network with rests";
  }
  return "unknown";
}

bool takes_small_network(Effort effort) {
  return effort == Effort::kSmallNetwork || effort == Effort::kSmallNetworkRest;
}

bool rests(Effort effort) { return effort == Effort::kSmallNetworkRest || effort == Effort::kRest; }

Effort DegradeLadder::judge(const LoadFacts& facts) {
  const std::int64_t now = facts.now_ns;
  follow_network(facts.has_small_network);
  const char* why = strain(facts);
  if (why == nullptr) {
    strained_since_ns_ = -1;
  } else if (strained_since_ns_ < 0) {
    strained_since_ns_ = now;
  }
  if (!at_ease(facts)) {
    at_ease_since_ns_ = -1;
  } else if (at_ease_since_ns_ < 0) {
    at_ease_since_ns_ = now;
  }
  const bool settled = last_lowered_ns_ < 0 || now - last_lowered_ns_ >= kSettleNs;
  if (why != nullptr && settled && now - strained_since_ns_ >= kStrainNs) {
    lower(facts, why);
  } else if (effort_ != Effort::kFull && at_ease_since_ns_ >= 0 &&
             now - std::max(at_ease_since_ns_, last_lowered_ns_) >= hold_ns_) {
    raise(now);
  }
  return effort_;
}

// A camera that came back different may have taken the smaller network away, or brought one: on
// with the nearest rung that there is. Without a smaller network nothing makes a slow one faster.
void DegradeLadder::follow_network(bool has_small) {
  if (has_small && effort_ == Effort::kRest) effort_ = Effort::kSmallNetwork;
  if (has_small || !takes_small_network(effort_)) return;
  effort_ = reason_ == kSlow ? Effort::kFull : Effort::kRest;
  if (effort_ == Effort::kFull) reason_ = "";
}

// Why there is too much work, or null. A slow network is cured by the smaller one only: a rest
// would make it slower.
const char* DegradeLadder::strain(const LoadFacts& facts) const {
  if (!rests(effort_)) {
    if (facts.throttled) return kThrottled;
    if (facts.headroom_celsius < kHotHeadroom) return kHot;
  }
  const bool slow = static_cast<double>(facts.inference_ns) * 1e-9 * least_rate_ > 1;
  return slow && facts.has_small_network && effort_ == Effort::kFull ? kSlow : nullptr;
}

bool DegradeLadder::at_ease(const LoadFacts& facts) const {
  return !facts.throttled && facts.headroom_celsius > kCoolHeadroom;
}

void DegradeLadder::lower(const LoadFacts& facts, const char* why) {
  const bool failed_soon = last_raised_ns_ >= 0 && facts.now_ns - last_raised_ns_ < kFailedSoonNs;
  hold_ns_ = failed_soon ? std::min(2 * hold_ns_, kMostHoldNs) : kFirstHoldNs;
  const Effort first = facts.has_small_network ? Effort::kSmallNetwork : Effort::kRest;
  effort_ = effort_ == Effort::kFull ? first : Effort::kSmallNetworkRest;
  reason_ = why;
  last_lowered_ns_ = facts.now_ns;
  strained_since_ns_ = -1;
  ++lowered_;
}

void DegradeLadder::raise(std::int64_t now_ns) {
  effort_ = effort_ == Effort::kSmallNetworkRest ? Effort::kSmallNetwork : Effort::kFull;
  if (effort_ == Effort::kFull) reason_ = "";
  last_raised_ns_ = now_ns;
  at_ease_since_ns_ = now_ns;
  ++raised_;
}

}  // namespace lcdm
