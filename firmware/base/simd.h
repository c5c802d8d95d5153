// Which instruction sets vectorised code is compiled for (the processor chooses among them at
// start), and how its loops are unrolled. Include before any Highway header.
#pragma once

#ifdef LCDM_SANITIZED
// One small target, nothing unrolled: the checks multiply the tiles' code, and all targets took a
// quarter of an hour to compile. The loops and their bounds are the same code.
#define HWY_DISABLED_TARGETS ~(HWY_SSE4 | HWY_NEON | HWY_EMU128 | HWY_SCALAR)
#else
// Scalable vectors cannot be held in arrays or structures; SSSE3 and the Ice Lake subset would only
// add size. What remains: scalar, SSE4, AVX2, AVX-512, NEON.
#define HWY_DISABLED_TARGETS \
  (HWY_SSSE3 | HWY_AVX3_DL | HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128)
#endif

#include "hwy/detect_targets.h"

#ifndef HWY_SVE_256  // unknown to Highway 0.16
#define HWY_SVE_256 0
#define HWY_SVE2_128 0
#endif

// Keeps small fixed loops over register tiles unrolled at any optimisation level.
#ifdef LCDM_SANITIZED
#define LCDM_UNROLL
#else
#define LCDM_UNROLL _Pragma("GCC unroll 16")
#endif
