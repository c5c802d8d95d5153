#include "firmware/pipeline/frame_decoder.h"

namespace lcdm {

Result<FrameFormat> prepare_pixels(FrameDecoder* decoder, const FrameFormat& format) {
  if (format.pixel != PixelFormat::kMjpeg) return format;
  if (decoder == nullptr) {
    return Status::error(StatusCode::kUnsupported, "the camera delivers MJPEG: no decoder for it");
  }
  return decoder->prepare(format);
}

Result<FrameView> pixels_of(FrameDecoder* decoder, const FrameView& frame) noexcept {
  if (frame.format.pixel != PixelFormat::kMjpeg) return frame;
  return decoder->decode(frame);
}

}  // namespace lcdm
