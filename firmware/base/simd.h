// Which instruction sets vectorised code is compiled for (the processor chooses among them at
// start), and how its loops are unrolled. Include before any Highway header.
#pragma once

#ifdef LCDM_SANITIZED
// One target, nothing unrolled: the checks multiply the tiles' code, and all targets took a quarter
// of an hour to compile. The smallest, but in the preset asan-avx512: most of the loops and their
// bounds are the same code.
#ifndef LCDM_SANITIZED_TARGET
#define LCDM_SANITIZED_TARGET HWY_SSE4
#endif
#define HWY_DISABLED_TARGETS ~(LCDM_SANITIZED_TARGET | HWY_NEON | HWY_EMU128 | HWY_SCALAR)
#else
// Scalable vectors cannot be held in arrays or structures; SSSE3 and what newer versions of Highway
// split off AVX-512, NEON and SSE4 would only add size: we ask the processor for its narrow
// products ourselves (kernels/operand-inl.h). What remains: scalar, SSE4, AVX2, AVX-512, NEON (of
// newer versions for cores without AES too, where narrow products are not native).
#define HWY_DISABLED_TARGETS                                                         \
  (HWY_SSE2 | HWY_SSSE3 | HWY_AVX3_DL | HWY_AVX3_ZEN4 | HWY_AVX3_SPR | HWY_AVX10_2 | \
   HWY_NEON_BF16 | HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128)
#endif

#include "hwy/detect_targets.h"

#ifndef HWY_SVE_256  // unknown to Highway 0.16
#define HWY_SVE_256 0
#define HWY_SVE2_128 0
#endif
#ifndef HWY_AVX3_ZEN4  // the rest: to 1.0.3
#define HWY_AVX3_ZEN4 0
#endif
#ifndef HWY_AVX3_SPR
#define HWY_AVX3_SPR 0
#endif
#ifndef HWY_SSE2
#define HWY_SSE2 0
#endif
#ifndef HWY_AVX10_2
#define HWY_AVX10_2 0
#endif
#ifndef HWY_NEON_BF16
#define HWY_NEON_BF16 0
#endif

// Keeps small fixed loops over register tiles unrolled at any optimisation level.
#ifdef LCDM_SANITIZED
#define LCDM_UNROLL
#else
#define LCDM_UNROLL _Pragma("GCC unroll 32")
#endif
