// Which instruction sets vectorised code is compiled for; the processor chooses among them at
// start. Include before any Highway header.
#pragma once

// Scalable vectors cannot be held in arrays or structures; SSSE3 and the Ice Lake subset would only
// add size. What remains: scalar, SSE4, AVX2, AVX-512, NEON.
#ifndef HWY_DISABLED_TARGETS
#define HWY_DISABLED_TARGETS \
  (HWY_SSSE3 | HWY_AVX3_DL | HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128)
#endif

#include "hwy/detect_targets.h"

#ifndef HWY_SVE_256  // unknown to Highway 0.16
#define HWY_SVE_256 0
#define HWY_SVE2_128 0
#endif
