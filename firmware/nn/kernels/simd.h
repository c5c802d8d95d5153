// Instruction sets and unrolling of the kernels. Include before any Highway header.
#pragma once

#ifdef LCDM_SANITIZED
// One small target, nothing unrolled: the checks multiply the tiles' code, and all targets took a
// quarter of an hour to compile. The loops and their bounds are the same code.
#define HWY_DISABLED_TARGETS ~(HWY_SSE4 | HWY_NEON | HWY_EMU128 | HWY_SCALAR)
#endif

#include "firmware/base/simd_targets.h"

// Keeps small fixed loops over register tiles unrolled at any optimisation level.
#ifdef LCDM_SANITIZED
#define LCDM_UNROLL
#else
#define LCDM_UNROLL _Pragma("GCC unroll 16")
#endif
