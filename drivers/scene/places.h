// The kinds of world a scene can be. Each fills a snapshot for a time; scene.cpp chooses.
#pragma once

#include "drivers/scene/parts.h"

namespace lcdm::scene {

// A street of houses, trees, cars and people, driven along at the height of a car's camera.
void fill_street(std::uint64_t seed, double seconds, Snapshot& out);
// A park way with trees, rocks, benches, people and hoops to fly through.
void fill_park(std::uint64_t seed, double seconds, Snapshot& out);
// A furnished room, walked around in.
void fill_room(std::uint64_t seed, double seconds, Snapshot& out);

// Things of every kind anywhere, indoors or out, seen from anywhere, not moving: for training, so
// that a network cannot guess depth from where things usually stand in a picture. Painted with the
// first `photographs` of textures() too.
void fill_medley(std::uint64_t seed, int photographs, Snapshot& out);

// A box or a few on top of each other.
void add_boxes(Random& random, const Place& place, Snapshot& out);
// One thing of those a medley has indoors, at `place`; a wire reaches `height` metres at most.
void add_indoor_thing(Random& random, const Place& place, float height, Snapshot& out);
// Whether `point` is at least `distance` metres from everything that stands there.
bool is_free(const Snapshot& snapshot, Vec3 point, float distance);

// Looks from `eye`: yaw to the right, pitch downwards, roll clockwise; radians.
void set_camera(Vec3 eye, float yaw, float pitch, float roll, Snapshot& out);

}  // namespace lcdm::scene
