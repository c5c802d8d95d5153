// Quads of 8-bit integers (AVX-512 VNNI, dot product of Armv8.2).
#if defined(LCDM_KERNELS_INT8_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef LCDM_KERNELS_INT8_INL_H
#undef LCDM_KERNELS_INT8_INL_H
#else
#define LCDM_KERNELS_INT8_INL_H
#endif

#include <cstddef>
#include <cstdint>

#include "firmware/nn/kernels/operand-inl.h"

HWY_BEFORE_NAMESPACE();
namespace lcdm::kernels {
namespace HWY_NAMESPACE {

// Rows are bytes of their own range, unsigned but where kSigned; columns are signed ones. Sums are
// 32-bit integers behind the face of floats.
struct Int8Operand {
  static constexpr bool kSigned = HWY_TARGET == HWY_NEON;  // both alike, as its instruction wants

  static constexpr Precision kPrecision = Precision::kInt8;
  static constexpr bool kScaled = true;
  static constexpr int kBlock = 0;

  template <class D, class V = hn::Vec<D>>
  static HWY_INLINE V dot(D d, V x, V w, V sum) {
#if HWY_TARGET == HWY_AVX3
    (void)d;
    asm("vpdpbusd %2, %1, %0" : "+v"(sum.raw) : "v"(x.raw), "v"(w.raw));
    return sum;
#elif HWY_TARGET == HWY_NEON
    (void)d;
    asm(LCDM_ARM_ASSEMBLER "sdot %0.4s, %1.16b, %2.16b" : "+w"(sum.raw) : "w"(x.raw), "w"(w.raw));
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

  // `count` numbers, a multiple of 4, into count / 4 words of the range that is returned.
  static HWY_INLINE RowRange narrow_rows(const float* from, int count, float* words) {
    const auto numbers = static_cast<std::size_t>(count);
    const RowRange range = range_of(from, numbers);
    const float inverse = range.scale > 0 ? 1.0F / range.scale : 0.0F;
    auto* bytes = reinterpret_cast<std::uint8_t*>(words);
    for_channels(numbers, [&](auto d, std::size_t i) HWY_ATTR {
      const auto above = hn::Sub(hn::LoadU(d, from + i), hn::Set(d, range.low));
      store_bytes(d, hn::Mul(above, hn::Set(d, inverse)), bytes + i);
    });
    return {range.low + static_cast<float>(kTurned) * range.scale, range.scale};
  }

 private:
  // A signed byte is the unsigned one less 128, which is its highest bit turned.
  static constexpr std::uint8_t kTurned = kSigned ? 0x80 : 0;

  // Numbers from 0 to 255, but for rounding.
  template <class D, class V = hn::Vec<D>>
  static HWY_INLINE void store_bytes([[maybe_unused]] D d, V x, std::uint8_t* to) {
#if HWY_TARGET == HWY_AVX3
    if constexpr (sizeof(V) == 64) {  // Highway's way saturates twice more than this needs
      const __m128i bytes = _mm512_cvtusepi32_epi8(_mm512_cvtps_epi32(x.raw));
      _mm_storeu_si128(reinterpret_cast<__m128i*>(to), bytes);
      return;
    }
#endif
    const hn::Rebind<std::uint8_t, D> d8;
    const auto byte = hn::DemoteTo(d8, hn::NearestInt(x));
    hn::StoreU(hn::Xor(byte, hn::Set(d8, kTurned)), d8, to);
  }

  // Two chains of minima and maxima, whose latency is otherwise what they cost. Those pass over
  // what is no number; its product with zero does not, and then there is no least.
  static HWY_INLINE RowRange range_of(const float* from, std::size_t count) {
    const FullTag d;
    FullVec low = hn::Set(d, from[0]);
    FullVec high = low;
    FullVec low2 = low;
    FullVec high2 = low;
    const FullVec zero = hn::Zero(d);
    FullVec none = zero;
    FullVec none2 = zero;
    std::size_t i = 0;
    for (; i + 2 * kLanes <= count; i += 2 * kLanes) {
      const FullVec v = hn::LoadU(d, from + i);
      const FullVec v2 = hn::LoadU(d, from + i + kLanes);
      low = hn::Min(low, v);
      high = hn::Max(high, v);
      low2 = hn::Min(low2, v2);
      high2 = hn::Max(high2, v2);
      none = hn::MulAdd(v, zero, none);
      none2 = hn::MulAdd(v2, zero, none2);
    }
    for (; i < count; ++i) {
      const FullVec v = hn::Set(d, from[i]);
      low = hn::Min(low, v);
      high = hn::Max(high, v);
      none = hn::MulAdd(v, zero, none);
    }
    low = hn::Min(low, low2);
    high = hn::Max(high, high2);
    const float least = hn::GetLane(hn::MinOfLanes(d, low));
    const float scale = (hn::GetLane(hn::MaxOfLanes(d, high)) - least) / 255.0F;
    return {least + hn::GetLane(hn::SumOfLanes(d, hn::Add(none, none2))), scale};
  }
};

}  // namespace HWY_NAMESPACE
}  // namespace lcdm::kernels
HWY_AFTER_NAMESPACE();

#endif
