// Which instruction sets the ray loops are compiled for; the processor chooses among them at start.
// Include before any other Highway header.
#pragma once

// Scalable vectors cannot be members of structures; the rest of the left-out only adds size.
#define HWY_DISABLED_TARGETS \
  (HWY_SSSE3 | HWY_AVX3_DL | HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128)

#include <hwy/detect_targets.h>
#ifndef HWY_SVE_256  // unknown to Highway 0.16
#define HWY_SVE_256 0
#define HWY_SVE2_128 0
#endif
