// `file:PATH`: a video, a folder of images or one image as a camera.
#pragma once

#include <memory>
#include <string>

#include "firmware/pipeline/camera.h"

namespace cv {
class Mat;
}

namespace lcdm {

// Frames are BGR24. Live: at the video's rate (images: the requested one), again from the beginning
// at the end, every frame resized to the first one's size. Offline: each frame once, as fast as it
// is taken, at its own size; format() is the first frame's, model() the newest frame's.
// Intrinsics come from intrinsics.json beside the images or one folder up; else they are assumed.
// A frame that cannot be read is kCorrupt, named, and leaves a gap in the sequence; the next call
// goes on behind it.
// Threads: as Camera. OpenCV allocates while it reads: the capture thread is not sealed.
class ReplayCamera final : public Camera {
 public:
  enum class Playback { kLive, kOffline };

  ReplayCamera(std::string path, Playback playback);
  ~ReplayCamera() override;
  ReplayCamera(const ReplayCamera&) = delete;
  ReplayCamera& operator=(const ReplayCamera&) = delete;

  Status configure(const CaptureRequest& request) override;
  const FrameFormat& format() const override { return format_; }
  CameraModel model() const override { return model_; }
  CameraInfo info() const override;
  int buffer_count() const override;
  // Images: the file's stem. Videos: the sequence, which offline is the frame's number.
  std::string frame_name(std::uint64_t sequence) const override;
  Status start() override;
  Result<CapturedFrame> dequeue(std::chrono::milliseconds timeout) override;
  Status requeue(int index) override;
  void stop() override;

 private:
  class Reader;    // OpenCV's side, so that its headers stay in the .cpp: files or an open video
  struct Buffers;  // images on loan and free

  bool live() const { return playback_ == Playback::kLive; }
  Status read_first_frame();
  CameraModel model_for(int width, int height) const;
  bool wait_for_turn(bool has_buffer, std::chrono::milliseconds timeout) const;
  Status read_next(cv::Mat& image);
  std::int64_t take_stamp();
  bool fit(cv::Mat& image) const;

  const std::string path_;
  const Playback playback_;
  std::unique_ptr<Reader> reader_;
  std::unique_ptr<Buffers> buffers_;
  FrameFormat format_;
  CameraModel calibration_;  // as the file gives it; width 0 where there is none
  CameraModel model_;
  float field_of_view_ = 0;
  float frames_per_second_ = 0;
  bool streaming_ = false;
  std::uint64_t sequence_ = 0;  // of the next frame
  std::int64_t due_ns_ = 0;     // when it may be handed out (live)
};

}  // namespace lcdm
