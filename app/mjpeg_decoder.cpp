#include "app/mjpeg_decoder.h"

#include <span>

namespace lcdm {

Result<FrameFormat> MjpegDecoder::prepare(const FrameFormat& compressed) {
  LCDM_RETURN_IF_ERROR(decoder_.prepare(compressed.width, compressed.height));
  format_ = {PixelFormat::kRgb24, compressed.width, compressed.height,
             packed_stride(PixelFormat::kRgb24, compressed.width)};
  pixels_.resize(static_cast<std::size_t>(format_.stride) *
                 static_cast<std::size_t>(format_.height));
  return format_;
}

Result<FrameView> MjpegDecoder::decode(const FrameView& frame) noexcept {
  LCDM_RETURN_IF_ERROR(decoder_.decode(std::span(frame.data, frame.bytes), pixels_));
  return FrameView{format_, frame.meta, pixels_.data(), pixels_.size()};
}

}  // namespace lcdm
