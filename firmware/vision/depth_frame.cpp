#include "firmware/vision/depth_frame.h"

namespace lcdm {

const char* to_string(ScaleKind scale) {
  return scale == ScaleKind::kMetric ? "metric" : "relative";
}

}  // namespace lcdm
