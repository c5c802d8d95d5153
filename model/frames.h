// Pictures with depth, read one by one: the interface between data on disk and everything that
// trains or measures.
#pragma once

#include <map>
#include <memory>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/vision/camera_model.h"

namespace lcdm::model {

constexpr int kFullWidth = 1 << 14;  // as `max_width`: pictures are not reduced

struct PackFrame {
  std::string name;
  cv::Mat rgb;         // CV_8UC3, RGB
  cv::Mat depth;       // CV_32FC1, metres along the optical axis, 0 = unknown; same view as rgb
  CameraModel camera;  // of rgb; not `calibrated`: assumed
};

// Frames of one camera or several, in an order of their own. Every method may be called from any
// thread at any time.
class Frames {
 public:
  Frames() = default;
  virtual ~Frames() = default;
  Frames(const Frames&) = delete;
  Frames& operator=(const Frames&) = delete;

  virtual std::size_t size() const = 0;
  virtual std::string name(std::size_t index) const = 0;
  // kNotFound, kCorrupt: a file of this frame is missing or cannot be used, named in the text.
  virtual Result<PackFrame> read(std::size_t index) const = 0;
  // Whether the pictures before and after `index` in time exist and can be had. Stills have none.
  virtual bool has_neighbours(std::size_t index) const;
  // The picture one frame before (`offset` -1) or after (+1), of the size of read()'s.
  virtual Result<cv::Mat> neighbour(std::size_t index, int offset) const;
};

// Frames already in memory. `video`: neighbours are neighbours in time, within a sequence.
// `unreadable`: why those that have but a name could not be read.
class MemoryFrames final : public Frames {
 public:
  MemoryFrames(std::vector<PackFrame> frames, bool video,
               std::map<std::size_t, Status> unreadable = {})
      : frames_(std::move(frames)), video_(video), unreadable_(std::move(unreadable)) {}

  std::size_t size() const override { return frames_.size(); }
  std::string name(std::size_t index) const override { return frames_[index].name; }
  Result<PackFrame> read(std::size_t index) const override;
  bool has_neighbours(std::size_t index) const override;
  Result<cv::Mat> neighbour(std::size_t index, int offset) const override;

 private:
  std::vector<PackFrame> frames_;
  bool video_;
  std::map<std::size_t, Status> unreadable_;
};

// The frames of `first`, and behind them those of `second`. Each keeps its own neighbours.
class JoinedFrames final : public Frames {
 public:
  JoinedFrames(std::shared_ptr<const Frames> first, std::shared_ptr<const Frames> second)
      : first_(std::move(first)), second_(std::move(second)) {}

  std::size_t size() const override { return first_->size() + second_->size(); }
  std::string name(std::size_t index) const override;
  Result<PackFrame> read(std::size_t index) const override;
  bool has_neighbours(std::size_t index) const override;
  Result<cv::Mat> neighbour(std::size_t index, int offset) const override;

 private:
  struct Place {
    const Frames& frames;
    std::size_t index;
  };
  Place place_of(std::size_t index) const;

  std::shared_ptr<const Frames> first_;
  std::shared_ptr<const Frames> second_;
};

// A frame's sequence: its name up to the first '_'; empty without one.
std::string sequence_of(const std::string& name);
// Whether the frames before and after `index` are of its sequence, and by the numbers in their
// names about as far from it: where frames are missing, neighbouring files are not neighbours in
// time.
bool amid_a_sequence(const Frames& frames, std::size_t index);

}  // namespace lcdm::model
