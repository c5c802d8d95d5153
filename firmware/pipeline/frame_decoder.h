// Turns a compressed camera frame into pixels: the infer thread's first step for MJPEG sources.
#pragma once

#include "firmware/base/status.h"
#include "firmware/buffer/frame.h"

namespace lcdm {

// Used from one thread at a time: prepare before the first frame, then decode on the infer thread.
class FrameDecoder {
 public:
  virtual ~FrameDecoder() = default;

  // Makes the slot for frames of `compressed`. May allocate. The result is what decode() gives.
  virtual Result<FrameFormat> prepare(const FrameFormat& compressed) = 0;

  // `frame` has the prepared format. The view points into the slot and is valid until the next
  // call. Allocates nothing. kCorrupt: the bytes are broken or of another size; the next frame may
  // be fine.
  virtual Result<FrameView> decode(const FrameView& frame) noexcept = 0;
};

// What stands in front of whatever reads pixels: MJPEG through the decoder, other formats as they
// are. kUnsupported: MJPEG without a decoder.
Result<FrameFormat> prepare_pixels(FrameDecoder* decoder, const FrameFormat& format);
// `frame` has the prepared format.
Result<FrameView> pixels_of(FrameDecoder* decoder, const FrameView& frame) noexcept;

}  // namespace lcdm
