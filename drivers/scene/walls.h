// A room's walls and what stands or hangs along them.
#pragma once

#include <array>

#include "drivers/scene/parts.h"

namespace lcdm::scene {

// A wall seen from inside: `along` metres to its right, the room's floor below.
struct Wall {
  Place middle;  // on the floor at the wall's foot, looking into the room
  float half;    // half its length
};

// Wall 0 to 3 of a room centred at the origin, `room` as in Snapshot.
Wall wall_of(const Vec3& room, int number);
// `off` metres into the room.
Place beside(const Wall& wall, float along, float off);

// The four walls, each with its paint and a plain skirting board, and the ceiling.
void add_walls(const std::array<Paint, 4>& paints, Snapshot& out);

constexpr int kPieces = 6;
// One piece of furniture (0 to 5: shelf, sofa, window, table, lamp, door) against the wall, and
// something above it.
void furnish(Random& random, const Wall& wall, float along, int piece, Snapshot& out);

}  // namespace lcdm::scene
