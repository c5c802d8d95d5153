// Pairs of IEEE half-precision numbers (FP16 arithmetic of Armv8.2).
//
// The instruction adds in half precision too: even k in the lower half of each word, odd k in the
// upper. So it sums kBlock words at most, and blocks are added up in float. (fmlal adds in float at
// once, but at the rate of floats, and the Cortex-A78AE we write for has it not.)
//
// Halves end at 65504 and lose bits below 6e-5: so the rows of a range, and each column, are
// divided by a power of two, which rounds nothing, to less than 2. Then no picture and no weights
// can make a block overflow.
#if defined(LCDM_KERNELS_FLOAT16_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef LCDM_KERNELS_FLOAT16_INL_H
#undef LCDM_KERNELS_FLOAT16_INL_H
#else
#define LCDM_KERNELS_FLOAT16_INL_H
#endif

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "firmware/nn/kernels/operand-inl.h"
#include "firmware/nn/kernels/words.h"

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

// The largest magnitude in `rows` rows of `count` numbers.
HWY_INLINE float largest_magnitude(const float* from, std::ptrdiff_t stride, int rows, int count) {
  constexpr int kStep = static_cast<int>(kLanes);
  const FullTag d;
  FullVec largest = hn::Zero(d);
  for (int m = 0; m < rows; ++m, from += stride) {
    int i = 0;
    for (; i + kStep <= count; i += kStep) {
      largest = hn::Max(largest, hn::Abs(hn::LoadU(d, from + i)));
    }
    for (; i < count; ++i) largest = hn::Max(largest, hn::Abs(hn::Set(d, from[i])));
  }
  return hn::GetLane(hn::MaxOfLanes(d, largest));
}

struct Float16Operand {
  static constexpr Precision kPrecision = Precision::kFloat16;
  static constexpr bool kScaled = true;
  // As exact as 16 (PERFORMANCE.md, "How exact narrow products are"), and adding up the blocks
  // costs half as much.
  static constexpr int kBlock = 32;

  template <class D, class V = hn::Vec<D>>
  static HWY_INLINE V dot(D d, V x, V w, V sum) {
#if LCDM_NATIVE_FLOAT16
    (void)d;
    asm(LCDM_ARM_ASSEMBLER "fmla %0.8h, %1.8h, %2.8h" : "+w"(sum.raw) : "w"(x.raw), "w"(w.raw));
    return sum;
#else
    sum = hn::MulAdd(lower_half(d, x), lower_half(d, w), sum);
    return hn::MulAdd(upper_half(d, x), upper_half(d, w), sum);
#endif
  }

  // A block's sums as floats.
  template <class D, class V = hn::Vec<D>>
  static HWY_INLINE V widened(D, V sum) {
#if LCDM_NATIVE_FLOAT16
    const float16x8_t halves = vreinterpretq_f16_f32(sum.raw);
    return V(vpaddq_f32(vcvt_f32_f16(vget_low_f16(halves)), vcvt_high_f32_f16(halves)));
#else
    return sum;
#endif
  }

  // `low` becomes the lower half of each word, `high` the upper.
  template <class D, class V = hn::Vec<D>>
  static HWY_INLINE V pair(D d, V low, V high) {
#if LCDM_NATIVE_FLOAT16
    if constexpr (sizeof(V) == sizeof(FullVec)) {
      const uint16x8_t both =
          vreinterpretq_u16_f16(vcvt_high_f16_f32(vcvt_f16_f32(low.raw), high.raw));
      return V(vreinterpretq_f32_u16(vzip1q_u16(both, vextq_u16(both, both, 4))));
    }
#endif
    HWY_ALIGN float words[kLanes];
    HWY_ALIGN float highs[kLanes];
    hn::Store(low, d, words);
    hn::Store(high, d, highs);
    for (std::size_t i = 0; i < hn::Lanes(d); ++i) {
      const std::uint32_t word = float16_pair(words[i], highs[i]);
      std::memcpy(words + i, &word, sizeof(word));
    }
    return hn::Load(d, words);
  }

  // `count` numbers of a row, a multiple of 2, times `factor` into count / 2 words.
  static HWY_INLINE void narrow(const float* from, int count, float factor, float* words) {
    int i = 0;
#if LCDM_NATIVE_FLOAT16
    for (; i + 8 <= count; i += 8) {
      const float16x4_t low = vcvt_f16_f32(vmulq_n_f32(vld1q_f32(from + i), factor));
      const float32x4_t high = vmulq_n_f32(vld1q_f32(from + i + 4), factor);
      vst1q_f32(words + i / 2, vreinterpretq_f32_f16(vcvt_high_f16_f32(low, high)));
    }
#endif
    for (; i < count; i += 2) {
      const std::uint32_t word = float16_pair(from[i] * factor, from[i + 1] * factor);
      std::memcpy(words + i / 2, &word, sizeof(word));
    }
  }

  static HWY_INLINE RowRange narrow_rows(const float* from, int count, float* words) {
    const PowerOfTwo scale = power_of_two_within(largest_magnitude(from, 0, 1, count));
    narrow(from, count, scale.inverse, words);
    return {0, scale.value};
  }

 private:
#if !LCDM_NATIVE_FLOAT16
  // Exponent and fraction are moved to where a float has them; a product corrects the exponent's
  // offset, subnormal numbers' too.
  template <class D, class V = hn::Vec<D>>
  static HWY_INLINE V upper_half(D d, V words) {
    const hn::RebindToUnsigned<D> du;
    const auto bits = hn::BitCast(du, words);
    const auto sign = hn::And(bits, hn::Set(du, 0x80000000U));
    const auto rest = hn::ShiftRight<3>(hn::And(bits, hn::Set(du, 0x7FFF0000U)));
    const auto magnitude = hn::Mul(hn::BitCast(d, rest), hn::Set(d, 0x1p112F));
    return hn::BitCast(d, hn::Or(sign, hn::BitCast(du, magnitude)));
  }
  template <class D, class V = hn::Vec<D>>
  static HWY_INLINE V lower_half(D d, V words) {
    const hn::RebindToUnsigned<D> du;
    return upper_half(d, hn::BitCast(d, hn::ShiftLeft<16>(hn::BitCast(du, words))));
  }
#endif
};

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#endif
