#include "firmware/pipeline/camera.h"

#include <cstdio>

namespace lcdm {

std::string Camera::frame_name(std::uint64_t sequence) const {
  char name[24];
  std::snprintf(name, sizeof(name), "%06llu", static_cast<unsigned long long>(sequence));
  return name;
}

}  // namespace lcdm
