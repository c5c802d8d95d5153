// What products multiply: floats, pairs of bfloat16 or quads of 8-bit integers, 32 bits a word.
//
// A word holds consecutive k of one row or column, so one register tile serves all: it broadcasts a
// word of a row, and each lane adds the dot product with its column's word to its sum. Highway
// (0.16 and 1.0) has no such dot product: where the processor has the instruction it is written out
// here; elsewhere it is put together, slowly, so that every path gives the same result everywhere.
#if defined(LCDM_KERNELS_OPERAND_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef LCDM_KERNELS_OPERAND_INL_H
#undef LCDM_KERNELS_OPERAND_INL_H
#else
#define LCDM_KERNELS_OPERAND_INL_H
#endif

#include <cstddef>
#include <cstdint>
#include <cstring>

#include "firmware/nn/kernels/math-inl.h"
#include "firmware/nn/kernels/matrix.h"
#include "firmware/nn/kernels/words.h"

// The instructions of this target; support_of() tells whether the processor has them too.
#undef LCDM_NATIVE_BFLOAT16
#undef LCDM_NATIVE_INT8
#define LCDM_NATIVE_BFLOAT16 (HWY_TARGET == HWY_AVX3)
#define LCDM_NATIVE_INT8 (HWY_TARGET == HWY_AVX3 || HWY_TARGET == HWY_NEON)

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

// The range of a row's bytes: number = low + scale * byte.
struct RowRange {
  float low = 0;
  float scale = 0;
};

// `low` becomes the lower half of each word, `high` the upper; rounded to nearest, ties away from
// zero. words.h and the processor's instruction round ties to even; that instruction puts numbers
// side by side, not one into each half, and to even by hand costs more operations than ties matter.
template <class D, class V = hn::Vec<D>>
HWY_INLINE V pair_words(D d, V low, V high) {
  const hn::RebindToUnsigned<D> du;
  const auto half = hn::Set(du, 0x8000U);
  const auto l = hn::ShiftRight<16>(hn::Add(hn::BitCast(du, low), half));
  const auto h = hn::And(hn::Add(hn::BitCast(du, high), half), hn::Set(du, 0xFFFF0000U));
  return hn::BitCast(d, hn::Or(l, h));
}

struct FloatOperand {
  static constexpr Precision kPrecision = Precision::kFloat32;

  template <class D, class V = hn::Vec<D>>
  static HWY_INLINE V dot(D, V x, V w, V sum) {
    return hn::MulAdd(x, w, sum);
  }
};

struct Bfloat16Operand {
  static constexpr Precision kPrecision = Precision::kBfloat16;

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

  static HWY_INLINE void narrow_rows(const float* from, std::ptrdiff_t stride, int rows, int count,
                                     float* words, RowRange*) {
    for (int m = 0; m < rows; ++m) narrow(from + m * stride, count, words + m * (count / 2));
  }

 private:
#if LCDM_NATIVE_BFLOAT16
  // From number i on, as many as fill whole vectors of words; returns the first that is left.
  template <class D>
  static HWY_INLINE int narrow_vectors(D d, int i, const float* from, int count, float* words) {
    const int lanes = static_cast<int>(hn::Lanes(d));
    for (; i + 2 * lanes <= count; i += 2 * lanes) {
      const auto low = hn::LoadU(d, from + i);
      auto high = hn::LoadU(d, from + i + lanes);
      asm("vcvtne2ps2bf16 %1, %0, %0" : "+v"(high.raw) : "v"(low.raw));
      hn::StoreU(high, d, words + i / 2);
    }
    return i;
  }
#endif
};

// Rows are bytes of their own range, unsigned but where kSigned; columns are signed ones. Sums are
// 32-bit integers behind the face of floats.
struct Int8Operand {
  static constexpr bool kSigned = HWY_TARGET == HWY_NEON;  // both alike, as its instruction wants

  static constexpr Precision kPrecision = Precision::kInt8;

  template <class D, class V = hn::Vec<D>>
  static HWY_INLINE V dot(D d, V x, V w, V sum) {
#if HWY_TARGET == HWY_AVX3
    (void)d;
    asm("vpdpbusd %2, %1, %0" : "+v"(sum.raw) : "v"(x.raw), "v"(w.raw));
    return sum;
#elif HWY_TARGET == HWY_NEON
    (void)d;
    // The compiler's target here is Armv8.0, so its assembler must be told of sdot. A whole .arch,
    // because binutils 2.40 refuses `.arch_extension dotprod` over an armv8-a base. It stays in
    // force for the rest of the unit, which is harmless: the assembler only accepts more, and what
    // the compiler itself chooses stays as it was (crypto is named because Highway's NEON may use
    // it). support_of() keeps this from running where the processor lacks it.
    asm(".arch armv8.2-a+crypto+dotprod\n\tsdot %0.4s, %1.16b, %2.16b"
        : "+w"(sum.raw)
        : "w"(x.raw), "w"(w.raw));
    return sum;
#else
    const hn::RebindToUnsigned<D> du;
    const hn::RebindToSigned<D> di;
    const auto byte = hn::Set(du, 0xFFU);
    const auto xu = hn::BitCast(du, x);
    const auto wi = hn::BitCast(di, w);
    const auto product = [&](auto x_byte, auto w_at_top) HWY_ATTR {
      return hn::Mul(hn::BitCast(di, x_byte), hn::ShiftRight<24>(w_at_top));
    };
    auto total = hn::BitCast(di, sum);
    total = hn::Add(total, product(hn::And(xu, byte), hn::ShiftLeft<24>(wi)));
    total = hn::Add(total, product(hn::And(hn::ShiftRight<8>(xu), byte), hn::ShiftLeft<16>(wi)));
    total = hn::Add(total, product(hn::And(hn::ShiftRight<16>(xu), byte), hn::ShiftLeft<8>(wi)));
    total = hn::Add(total, product(hn::ShiftRight<24>(xu), wi));
    return hn::BitCast(d, total);
#endif
  }

  // `count` numbers of each row, a multiple of 4, into count / 4 words. The rows share one range.
  static HWY_INLINE void narrow_rows(const float* from, std::ptrdiff_t stride, int rows, int count,
                                     float* words, RowRange* ranges) {
    const RowRange range = range_of(from, stride, rows, static_cast<std::size_t>(count));
    const float inverse = range.scale > 0 ? 1.0F / range.scale : 0.0F;
    // A signed byte is the unsigned one less 128, which is its highest bit turned.
    const std::uint8_t turned = kSigned ? 0x80 : 0;
    const RowRange given = {range.low + static_cast<float>(turned) * range.scale, range.scale};
    auto* bytes = reinterpret_cast<std::uint8_t*>(words);
    for (int m = 0; m < rows; ++m, from += stride, bytes += count) {
      ranges[m] = given;
      for_channels(static_cast<std::size_t>(count), [&](auto d, std::size_t i) HWY_ATTR {
        const auto x =
            hn::Mul(hn::Sub(hn::LoadU(d, from + i), hn::Set(d, range.low)), hn::Set(d, inverse));
        const hn::Rebind<std::uint8_t, decltype(d)> d8;
        const auto byte = hn::DemoteTo(d8, hn::NearestInt(x));
        hn::StoreU(hn::Xor(byte, hn::Set(d8, turned)), d8, bytes + i);
      });
    }
  }

 private:
  static HWY_INLINE RowRange range_of(const float* from, std::ptrdiff_t stride, int rows,
                                      std::size_t count) {
    const FullTag d;
    FullVec low = hn::Set(d, from[0]);
    FullVec high = low;
    for (int m = 0; m < rows; ++m, from += stride) {
      std::size_t i = 0;
      for (; i + kLanes <= count; i += kLanes) {
        const FullVec v = hn::LoadU(d, from + i);
        low = hn::Min(low, v);
        high = hn::Max(high, v);
      }
      for (; i < count; ++i) {
        low = hn::Min(low, hn::Set(d, from[i]));
        high = hn::Max(high, hn::Set(d, from[i]));
      }
    }
    const float least = hn::GetLane(hn::MinOfLanes(d, low));
    return {least, (hn::GetLane(hn::MaxOfLanes(d, high)) - least) / 255.0F};
  }
};

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#endif
