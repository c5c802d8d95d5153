// Pairs of bfloat16 (AVX-512 BF16).
#if defined(LCDM_KERNELS_BFLOAT16_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef LCDM_KERNELS_BFLOAT16_INL_H
#undef LCDM_KERNELS_BFLOAT16_INL_H
#else
#define LCDM_KERNELS_BFLOAT16_INL_H
#endif

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "firmware/nn/kernels/operand-inl.h"
#include "firmware/nn/kernels/words.h"

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

struct Bfloat16Operand {
  static constexpr Precision kPrecision = Precision::kBfloat16;
  static constexpr bool kScaled = false;
  static constexpr int kBlock = 0;

  template <class D, class V = hn::Vec<D>>
  static HWY_INLINE V dot(D d, V x, V w, V sum) {
#if LCDM_NATIVE_BFLOAT16
    (void)d;
    asm("vdpbf16ps %2, %1, %0" : "+v"(sum.raw) : "v"(w.raw), "v"(x.raw));
    return sum;
#else
    const hn::RebindToUnsigned<D> du;
    const auto upper = hn::Set(du, 0xFFFF0000U);
    const auto xu = hn::BitCast(du, x);
    const auto wu = hn::BitCast(du, w);
    sum = hn::MulAdd(hn::BitCast(d, hn::And(xu, upper)), hn::BitCast(d, hn::And(wu, upper)), sum);
    return hn::MulAdd(hn::BitCast(d, hn::ShiftLeft<16>(xu)), hn::BitCast(d, hn::ShiftLeft<16>(wu)),
                      sum);
#endif
  }

  // `low` becomes the lower half of each word, `high` the upper; rounded to nearest, ties away from
  // zero. words.h and the processor's instruction round ties to even; that instruction puts numbers
  // side by side, not one into each half, and to even by hand costs more operations than ties
  // matter.
  template <class D, class V = hn::Vec<D>>
  static HWY_INLINE V pair(D d, V low, V high) {
    const hn::RebindToUnsigned<D> du;
    const auto half = hn::Set(du, 0x8000U);
    const auto l = hn::ShiftRight<16>(hn::Add(hn::BitCast(du, low), half));
    const auto h = hn::And(hn::Add(hn::BitCast(du, high), half), hn::Set(du, 0xFFFF0000U));
    return hn::BitCast(d, hn::Or(l, h));
  }

  // The pair 1, 1: the dot product with it is a pair's sum.
  template <class D>
  static HWY_INLINE hn::Vec<D> ones(D d) {
    return hn::BitCast(d, hn::Set(hn::RebindToUnsigned<D>(), 0x3F803F80U));
  }

  // The pair 2^low, 2^high, within 1 % (.3 % root mean square), for powers within 126 of 0; of -127
  // it is 0.
  template <class D, class V = hn::Vec<D>>
  static HWY_INLINE V pair_of_powers(D d, V low, V high) {
#if LCDM_NATIVE_BFLOAT16
    const V lower = hn::Add(low, hn::Set(d, kPowerInHalves));
    const V upper = hn::Add(high, hn::Set(d, kPowerInHalves));
    const __m512i both =
        _mm512_mask_mov_epi16(_mm512_slli_epi32(_mm512_castps_si512(upper.raw), 16), 0x55555555U,
                              _mm512_castps_si512(lower.raw));
    return V{_mm512_castsi512_ps(bend_powers(both))};
#else
    return pair(d, rough_exp2_within(d, low), rough_exp2_within(d, high));
#endif
  }

  // Words of consecutive numbers: those of `first` in the lower half of the vector, of `second` in
  // the upper.
  template <class D, class V = hn::Vec<D>>
  static HWY_INLINE V joined(D d, V first, V second) {
#if LCDM_NATIVE_BFLOAT16
    (void)d;
    asm("vcvtne2ps2bf16 %1, %0, %0" : "+v"(second.raw) : "v"(first.raw));
    return second;
#else
    HWY_ALIGN float numbers[2 * kLanes];
    HWY_ALIGN float words[kLanes];
    hn::Store(first, d, numbers);
    hn::StoreU(second, d, numbers + hn::Lanes(d));
    narrow(numbers, 2 * static_cast<int>(hn::Lanes(d)), words);
    return hn::Load(d, words);
#endif
  }

  // `count` numbers of a row, a multiple of 2, into count / 2 words.
  static HWY_INLINE void narrow(const float* from, int count, float* words) {
    int i = 0;
#if LCDM_NATIVE_BFLOAT16
    i = narrow_vectors(FullTag(), i, from, count, words);
    i = narrow_vectors(HWY_CAPPED(float, 8)(), i, from, count, words);
    i = narrow_vectors(HWY_CAPPED(float, 4)(), i, from, count, words);
#endif
    for (; i < count; i += 2) {
      const std::uint32_t word = bfloat16_pair(from[i], from[i + 1]);
      std::memcpy(words + i / 2, &word, sizeof(word));
    }
  }

  static HWY_INLINE RowRange narrow_rows(const float* from, int count, float* words) {
    narrow(from, count, words);
    return {};
  }

 private:
#if LCDM_NATIVE_BFLOAT16
  // Added to x of moderate size it leaves 128 (x + 127), rounded, in the lower half of the float's
  // bits: as a bfloat16 (eight bits of exponent, seven of mantissa) that is 2^n (1 + f) of
  // x = n + f.
  static constexpr float kPowerInHalves = 98304.0F + 127.0F;  // 1.5 * 2^16

  // Each half's 1 + f made 2^f: the difference, in units of the last of seven bits, by the upper
  // five bits of f. Nothing for a half that is 0.
  static HWY_INLINE __m512i bend_powers(__m512i halves) {
    HWY_ALIGN static constexpr std::int16_t kDifference[2 * kLanes] = {
        0,   -2,  -3,  -4,  -5,  -6,  -7,  -7, -8, -9, -9, -10, -10, -10, -11, -11,
        -11, -11, -11, -11, -10, -10, -10, -9, -8, -8, -7, -6,  -5,  -4,  -2,  -1};
    return _mm512_add_epi16(halves, _mm512_permutexvar_epi16(_mm512_srli_epi16(halves, 2),
                                                             _mm512_load_si512(kDifference)));
  }

  // From number i on, as many as fill whole vectors of words; returns the first that is left.
  template <class D>
  static HWY_INLINE int narrow_vectors(D d, int i, const float* from, int count, float* words) {
    const int lanes = static_cast<int>(hn::Lanes(d));
    for (; i + 2 * lanes <= count; i += 2 * lanes) {
      hn::StoreU(joined(d, hn::LoadU(d, from + i), hn::LoadU(d, from + i + lanes)), d,
                 words + i / 2);
    }
    return i;
  }
#endif
};

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#endif
