// The pipeline's decoder of MJPEG frames.
#pragma once

#include <vector>

#include "drivers/codec/codec.h"
#include "firmware/pipeline/frame_decoder.h"

namespace lcdm {

class MjpegDecoder final : public FrameDecoder {
 public:
  Result<FrameFormat> prepare(const FrameFormat& compressed) override;
  Result<FrameView> decode(const FrameView& frame) noexcept override;

 private:
  JpegDecoder decoder_;
  FrameFormat format_;  // of what decode gives: RGB24, rows packed
  std::vector<std::uint8_t> pixels_;
};

}  // namespace lcdm
