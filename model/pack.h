// Packs: folders of pictures with depth, split into training and validation.
#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "firmware/base/status.h"
#include "model/frames.h"

namespace lcdm::model {

// Where a frame's depth comes from: a sensor, the renderer, maps that a teacher made, nowhere. In
// the order in which a network's score on it is believed.
enum class Teacher : std::uint8_t { kSensor, kRenderer, kMaps, kNone };

// What training adjusts in a teacher's depth before learning from it, always towards the student:
// nothing, its scale, or scale and shift of its inverse depth (affine-invariant teachers).
enum class Alignment : std::uint8_t { kNone, kScale, kAffine };

// As catalogues and a teacher's folder name it: none, scale, affine.
const std::map<std::string, Alignment>& alignment_names();

// How a pack is used; one entry of the catalogue.
struct PackUse {
  std::string name;
  Teacher teacher = Teacher::kSensor;
  float field_of_view = 0;  // horizontal degrees assumed where the intrinsics are unknown
  bool learn_intrinsics =
      false;                     // from the photometric loss; what is known or assumed is the start
  float weight = 1;              // trust in its depth, in the losses
  float wide_share = 0;          // how often it is drawn for batches of the wide shape
  float tall_share = 0;          // and for those of the 4:3 shape
  float things = 0;              // the share of its training pictures that get rendered things
  bool video = false;            // neighbouring frames are neighbours in time
  std::string maps = "teacher";  // the folder of a teacher's maps, unit 1/256 m
  Alignment alignment = Alignment::kNone;
  int photographs = 0;  // that a rendering's medleys are painted with
};

struct Pack {
  PackUse use;
  std::filesystem::path folder;  // empty: its frames do not lie in one
  std::shared_ptr<const Frames> frames;
  std::vector<std::size_t> train;  // indices of frames
  std::vector<std::size_t> validation;
};

struct Split {
  std::vector<std::size_t> train;
  std::vector<std::size_t> validation;
};
// Per sequence (frame names up to the first '_'; one sequence without it): the last 10 % validate,
// the 20 frames before them are not used, the rest trains. Sequences too short for that (fewer than
// 34 frames) only train.
Split split_frames(const std::vector<std::string>& names);

// The frames of a folder with rgb/NAME.jpg|png, intrinsics.json and depth/NAME.png or the maps
// (with band.json), or of a clip: pictures and intrinsics.txt (fx fy cx cy) side by side. Pictures
// wider than `max_width` are reduced. Up to 1,500 frames are read at once and kept in memory,
// larger packs when they are needed; a broken one fails in read(), by its name. kNotFound: no such
// folder; kCorrupt, kInvalidInput: the pack cannot be used, its file named in the text. `every` > 1
// keeps every n-th frame, in the part where it is without.
Result<Pack> load_pack(const std::filesystem::path& root, const PackUse& use, int max_width,
                       std::size_t every = 1);

// Where a teacher's maps of whole pictures lie beside a pack's own depth, to be compared with;
// empty: nowhere.
std::filesystem::path maps_beside_depth(const Pack& pack);

// Inverse depth resized bilinearly. 0 where anything of a hole would go in.
cv::Mat resize_inverse(const cv::Mat& depth, cv::Size size);

}  // namespace lcdm::model
