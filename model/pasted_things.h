// Rendered things put into real pictures: boxes, chairs, people stand where the sensor saw
// something level, with their exact depth and their shadow, so that a network meets things where
// real rooms showed it none.
#pragma once

#include <cstdint>
#include <optional>

#include "drivers/scene/math.h"
#include "model/frames.h"

namespace lcdm::model {

// Something level in a picture: a floor, a table. Camera axes, metres.
struct LevelPlane {
  scene::Vec3 up;    // unit normal, towards the camera's side
  float height = 0;  // of the camera above it
};

// The level plane that most of the frame's known depth lies on, among `seed`'s random triples of
// points; nothing where less than a tenth does, or where all is steeper than 50 degrees.
std::optional<LevelPlane> find_level_plane(const PackFrame& frame, std::uint64_t seed);

// Puts one to four of `seed`'s things on the frame's level plane, behind what is nearer. False, the
// frame as it was, without such a plane or where they would hide most of the picture.
bool paste_things(std::uint64_t seed, PackFrame& frame);

}  // namespace lcdm::model
