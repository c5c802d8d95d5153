// A consumer of finished depth: the page's encoder, the recorder, a file writer.
#pragma once

#include "firmware/vision/depth_frame.h"

namespace lcdm {

class DepthSink {
 public:
  virtual ~DepthSink() = default;

  // Called on the infer thread for every frame. Copies what it wants into memory of its own that
  // was allocated before the pipeline started, or drops the frame and counts it. Never blocks,
  // never allocates.
  virtual void offer(const DepthFrame& frame) noexcept = 0;
};

}  // namespace lcdm
