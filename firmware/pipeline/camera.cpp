#include "firmware/pipeline/camera.h"

#include <cstdio>

namespace lcdm {

const char* to_string(StampSource stamp) {
  switch (stamp) {
    case StampSource::kArrival:
      return "arrival";
    case StampSource::kEndOfFrame:
      return "end of frame";
    case StampSource::kStartOfExposure:
      return "start of exposure";
  }
  return "unknown";
}

std::string Camera::frame_name(std::uint64_t sequence) const {
  char name[24];
  std::snprintf(name, sizeof(name), "%06llu", static_cast<unsigned long long>(sequence));
  return name;
}

}  // namespace lcdm
