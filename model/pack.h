// Packs of frames with depth: read once, kept small in memory, split into training and validation.
#pragma once

#include <filesystem>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/vision/camera_model.h"

namespace lcdm::model {

struct PackFrame {
  std::string name;
  cv::Mat rgb;         // CV_8UC3, RGB
  cv::Mat depth;       // CV_32FC1, metres along the optical axis, 0 = unknown; same view as rgb
  CameraModel camera;  // of rgb
};

// How a pack is used; one line of the catalogue.
struct PackUse {
  std::string name;
  enum class Teacher : std::uint8_t { kSensor, kMeter } teacher = Teacher::kSensor;
  float field_of_view = 0;  // horizontal degrees assumed where the intrinsics are unknown
  float weight = 1;         // trust in its depth, in the losses
  float wide_share = 0;     // how often it is drawn for batches of the wide shape
  float tall_share = 0;     // and for those of the 4:3 shape
  bool video = false;       // neighbouring frames are neighbours in time
};

struct Pack {
  PackUse use;
  std::vector<PackFrame> frames;
  std::vector<std::size_t> train;  // indices of frames
  std::vector<std::size_t> validation;

  // Whether frame `index` has a frame before and after it in the same drive.
  bool has_neighbours(std::size_t index) const;
};

// The training packs of the shared data and how they are mixed.
const std::vector<PackUse>& training_packs();
// The test packs; never trained on.
const std::vector<PackUse>& test_packs();

struct Split {
  std::vector<std::size_t> train;
  std::vector<std::size_t> validation;
};
// Per sequence (frame names up to the first '_'; one sequence without it): the last 10 % validate,
// the 20 frames before them are not used, the rest trains. Sequences too short for that (fewer than
// 34 frames) only train.
Split split_frames(const std::vector<std::string>& names);

// Reads root/use.name with rgb/, intrinsics.json and depth/ or teacher_meter/ (with band.json), or
// a clip: pictures and intrinsics.txt (fx fy cx cy) side by side.
// Pictures wider than `max_width` are reduced. kNotFound: no such folder; kCorrupt: a file in it
// cannot be used, named in the text. `every` > 1 keeps every n-th frame.
Result<Pack> load_pack(const std::filesystem::path& root, const PackUse& use, int max_width,
                       std::size_t every = 1);

// Inverse depth resized bilinearly, holes kept holes: for teachers whose maps have no holes.
cv::Mat resize_inverse(const cv::Mat& depth, cv::Size size);

}  // namespace lcdm::model
