#include "firmware/vision/rgb_row.h"

#include <algorithm>
#include <cstddef>
#include <cstring>

#include "firmware/base/check.h"

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "firmware/vision/rgb_row.cpp"
#include "firmware/base/simd.h"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace lcdm {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

// 16-bit fixed point with 5 binary places: luma comes as (y - 16) << 7, chroma as (c - 128) << 8,
// and of a product with these the upper half is kept. It is rounded down, by half on average;
// three of them and the last rounding make kRound.
constexpr int kPlaces = 5;
constexpr std::int16_t kLuma = 19077;    // 255 / 219 * 2^14
constexpr std::int16_t kRedV = 13075;    // 1.596027 * 2^13
constexpr std::int16_t kGreenU = -3209;  // -0.391762 * 2^13
constexpr std::int16_t kGreenV = -6660;  // -0.812968 * 2^13
constexpr std::int16_t kBlueU = 16525;   // 2.017232 * 2^13
constexpr std::int16_t kRound = 17;

inline int upper_half(int a, int b) { return (a * b) >> 16; }

// The same arithmetic as convert_blocks, for the pixels that fill no vector.
inline void convert_pixel(int y, int u, int v, std::uint8_t* rgb) {
  const auto to_byte = [](int value) {
    return static_cast<std::uint8_t>(std::clamp(value >> kPlaces, 0, 255));
  };
  const int luma = upper_half(std::max(y - 16, 0) * 128, kLuma) + kRound;
  const int u8 = (u - 128) * 256;
  const int v8 = (v - 128) * 256;
  rgb[0] = to_byte(luma + upper_half(v8, kRedV));
  rgb[1] = to_byte(luma + upper_half(u8, kGreenU) + upper_half(v8, kGreenV));
  rgb[2] = to_byte(luma + upper_half(u8, kBlueU));
}

#if HWY_TARGET == HWY_SCALAR
std::size_t convert_blocks(PixelFormat /*pixel*/, const YuvRow& /*row*/, std::size_t /*width*/,
                           std::uint8_t* /*out*/) {
  return 0;
}
std::size_t grey_blocks(const std::uint8_t* /*grey*/, std::size_t /*width*/,
                        std::uint8_t* /*out*/) {
  return 0;
}
#else
using Words = HWY_FULL(std::int16_t);
using Unsigned = hn::RebindToUnsigned<Words>;
using Pairs = hn::RepartitionToWide<Unsigned>;
using Bytes = hn::Rebind<std::uint8_t, Words>;

// Luma of consecutive pixels, and their chroma: U and V in turns.
struct Samples {
  hn::Vec<Unsigned> luma;
  hn::Vec<Unsigned> chroma;
};

HWY_INLINE Samples load_samples(PixelFormat pixel, const YuvRow& row, std::size_t x) {
  const Unsigned d;
  const Bytes bytes;
  if (row.luma_step == 1) {
    const std::uint8_t* chroma = std::min(row.u, row.v);
    return {hn::PromoteTo(d, hn::LoadU(bytes, row.luma + x)),
            hn::PromoteTo(d, hn::LoadU(bytes, chroma + x))};
  }
  const bool luma_first = pixel == PixelFormat::kYuyv;
  const std::uint8_t* packed = luma_first ? row.luma : row.u;
  const hn::Repartition<std::uint8_t, Unsigned> raw;
  const auto both = hn::BitCast(d, hn::LoadU(raw, packed + 2 * x));
  const auto low = hn::And(both, hn::Set(d, std::uint16_t{0xFF}));
  const auto high = hn::ShiftRight<8>(both);
  if (luma_first) return {low, high};
  return {high, low};
}

// Whole vectors of pixels; returns how many pixels.
std::size_t convert_blocks(PixelFormat pixel, const YuvRow& row, std::size_t width,
                           std::uint8_t* out) {
  const Words d;
  const Pairs pairs;
  const Bytes bytes;
  const bool u_first = pixel != PixelFormat::kNv21;
  const auto low_word = hn::Set(pairs, 0xFFFFU);
  const auto middle = hn::Set(d, std::int16_t{128});
  std::size_t x = 0;
  for (; x + hn::Lanes(d) <= width; x += hn::Lanes(d)) {
    const Samples samples = load_samples(pixel, row, x);
    const auto chroma = hn::BitCast(pairs, samples.chroma);
    const auto first = hn::And(chroma, low_word);
    const auto second = hn::ShiftRight<16>(chroma);
    const auto centred = [&](auto half) HWY_ATTR {  // for both pixels of the pair
      const auto twice = hn::BitCast(d, hn::Or(half, hn::ShiftLeft<16>(half)));
      return hn::ShiftLeft<8>(hn::Sub(twice, middle));
    };
    const auto u = centred(u_first ? first : second);
    const auto v = centred(u_first ? second : first);
    const auto above_black =
        hn::Max(hn::Sub(hn::BitCast(d, samples.luma), hn::Set(d, std::int16_t{16})), hn::Zero(d));
    const auto luma =
        hn::Add(hn::MulHigh(hn::ShiftLeft<7>(above_black), hn::Set(d, kLuma)), hn::Set(d, kRound));
    const auto red = hn::Add(luma, hn::MulHigh(v, hn::Set(d, kRedV)));
    const auto green = hn::Add(hn::Add(luma, hn::MulHigh(u, hn::Set(d, kGreenU))),
                               hn::MulHigh(v, hn::Set(d, kGreenV)));
    const auto blue = hn::Add(luma, hn::MulHigh(u, hn::Set(d, kBlueU)));
    hn::StoreInterleaved3(hn::DemoteTo(bytes, hn::ShiftRight<kPlaces>(red)),
                          hn::DemoteTo(bytes, hn::ShiftRight<kPlaces>(green)),
                          hn::DemoteTo(bytes, hn::ShiftRight<kPlaces>(blue)), bytes, out + 3 * x);
  }
  return x;
}

std::size_t grey_blocks(const std::uint8_t* grey, std::size_t width, std::uint8_t* out) {
  const HWY_FULL(std::uint8_t) d;
  std::size_t x = 0;
  for (; x + hn::Lanes(d) <= width; x += hn::Lanes(d)) {
    const auto value = hn::LoadU(d, grey + x);
    hn::StoreInterleaved3(value, value, value, d, out + 3 * x);
  }
  return x;
}
#endif

void convert_yuv(const FrameView& frame, int y, std::uint8_t* out) {
  const YuvRow row = yuv_row(frame, y);
  const auto width = static_cast<std::size_t>(frame.format.width);
  for (std::size_t x = convert_blocks(frame.format.pixel, row, width, out); x < width; ++x) {
    const std::size_t chroma = x / 2 * static_cast<std::size_t>(row.chroma_step);
    convert_pixel(row.luma[x * static_cast<std::size_t>(row.luma_step)], row.u[chroma],
                  row.v[chroma], out + 3 * x);
  }
}

void convert_grey(const std::uint8_t* grey, std::size_t width, std::uint8_t* out) {
  for (std::size_t x = grey_blocks(grey, width, out); x < width; ++x) {
    std::fill_n(out + 3 * x, 3, grey[x]);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace lcdm
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm {

HWY_EXPORT(convert_yuv);
HWY_EXPORT(convert_grey);

void rgb_row(const FrameView& frame, int y, std::uint8_t* out) noexcept {
  const FrameFormat& format = frame.format;
  const auto width = static_cast<std::size_t>(format.width);
  const std::uint8_t* row =
      frame.data + static_cast<std::size_t>(y) * static_cast<std::size_t>(format.stride);
  switch (format.pixel) {
    case PixelFormat::kRgb24:
      std::memcpy(out, row, width * 3);
      return;
    case PixelFormat::kBgr24:
      for (std::size_t x = 0; x < width * 3; x += 3) {
        out[x] = row[x + 2];
        out[x + 1] = row[x + 1];
        out[x + 2] = row[x];
      }
      return;
    case PixelFormat::kYuyv:
    case PixelFormat::kUyvy:
    case PixelFormat::kNv12:
    case PixelFormat::kNv21:
      HWY_DYNAMIC_DISPATCH(convert_yuv)(frame, y, out);
      return;
    case PixelFormat::kGrey:
      HWY_DYNAMIC_DISPATCH(convert_grey)(row, width, out);
      return;
    case PixelFormat::kMjpeg:
      break;
  }
  LCDM_CHECK(!"a compressed frame has no rows");
}

}  // namespace lcdm
#endif  // HWY_ONCE
