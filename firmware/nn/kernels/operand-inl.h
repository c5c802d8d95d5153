// What products multiply: floats, pairs of half-precision numbers or quads of 8-bit integers, 32
// bits a word. Here are floats and what all share; bfloat16-inl.h, float16-inl.h and int8-inl.h are
// one instruction each.
//
// A word holds consecutive k of one row or column, so one register tile serves all: it broadcasts a
// word of a row, and each lane adds the dot product with its column's word to its sum. Highway
// (0.16 and 1.0) has no such dot product: where the processor has the instruction it is written
// out; elsewhere it is put together, slowly, so that every path can be tested everywhere.
#if defined(LCDM_KERNELS_OPERAND_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef LCDM_KERNELS_OPERAND_INL_H
#undef LCDM_KERNELS_OPERAND_INL_H
#else
#define LCDM_KERNELS_OPERAND_INL_H
#endif

#include <cstddef>

#include "firmware/nn/kernels/math-inl.h"
#include "firmware/nn/kernels/matrix.h"

// The instructions of this target; support_of() tells whether the processor has them too.
#undef LCDM_NATIVE_FLOAT16
#undef LCDM_NATIVE_BFLOAT16
#undef LCDM_NATIVE_INT8
#define LCDM_NATIVE_FLOAT16 (HWY_TARGET == HWY_NEON)
#define LCDM_NATIVE_BFLOAT16 (HWY_TARGET == HWY_AVX3)
#define LCDM_NATIVE_INT8 (HWY_TARGET == HWY_AVX3 || HWY_TARGET == HWY_NEON)

// The compiler's target on Arm is Armv8.0, so its assembler must be told of what we write out. A
// whole .arch, because binutils 2.40 refuses `.arch_extension dotprod` over an armv8-a base. It
// stays in force for the rest of the unit, which is harmless: the assembler only accepts more, and
// what the compiler itself chooses stays as it was (crypto is named because Highway's NEON may use
// it). support_of() keeps these from running where the processor lacks them.
#define LCDM_ARM_ASSEMBLER ".arch armv8.2-a+crypto+dotprod+fp16\n\t"

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

struct FloatOperand {
  static constexpr Precision kPrecision = Precision::kFloat32;
  static constexpr bool kScaled = false;  // else sums are in units of their row and column
  static constexpr int kBlock = 0;        // words that may be summed at once; 0: all

  template <class D, class V = hn::Vec<D>>
  static HWY_INLINE V dot(D, V x, V w, V sum) {
    return hn::MulAdd(x, w, sum);
  }
};

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#endif
