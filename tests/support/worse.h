// The worst of many differences.
#pragma once

#include <algorithm>
#include <limits>

namespace lcdm::test {

// The larger of the two; infinite where the difference is no number, which std::max passes over.
inline double worse(double worst, double difference) {
  constexpr double kMost = std::numeric_limits<double>::max();
  return difference <= kMost ? std::max(worst, difference)
                             : std::numeric_limits<double>::infinity();
}

}  // namespace lcdm::test
