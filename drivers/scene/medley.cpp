// Medleys: rooms and open grounds of any size and paint, things of every kind thrown about, a
// camera anywhere among them.
#include <algorithm>
#include <array>
#include <cmath>

#include "drivers/scene/parts.h"
#include "drivers/scene/places.h"
#include "drivers/scene/walls.h"

namespace lcdm::scene {
namespace {

enum Salt : std::uint64_t { kShell = 11, kThings, kEye };

// Where things may stand: |x| and |z| up to these.
struct Yard {
  float x;
  float z;
};

// As often small as large, by factors.
float spread(Random& random, float low, float high) {
  return low * std::pow(high / low, random.unit());
}

Vec3 any_colour(Random& random) {
  const float grey = random.between(0.08F, 0.95F);
  const float vivid = random.chance(0.25F) ? random.between(0.2F, 1) : random.between(0, 0.25F);
  return mix({grey, grey, grey}, {random.unit(), random.unit(), random.unit()}, vivid);
}

// In every second case a photograph, where there are some: surfaces as they really look.
Paint any_paint(Random& random, const Snapshot& out) {
  static constexpr std::array<Texture, 12> kTexturesOfThings{
      Texture::kPlain,   Texture::kPlain, Texture::kPlaster,  Texture::kBrick,
      Texture::kPlanks,  Texture::kWeave, Texture::kConcrete, Texture::kTiles,
      Texture::kStripes, Texture::kBooks, Texture::kPainting, Texture::kAsphalt};
  const Vec3 light = any_colour(random);
  const Vec3 dark = random.chance(0.25F) ? any_colour(random) : light * random.between(0.5F, 0.95F);
  const auto texture = kTexturesOfThings[static_cast<std::size_t>(random.below(12))];
  if (out.photographs > 0 && random.chance(0.5F)) {
    const Vec3 shade = light * random.between(0.05F, 0.6F);
    return {photograph(random.below(out.photographs)), shade, light, spread(random, 0.3F, 4)};
  }
  return {texture, dark, light, spread(random, 0.4F, 3)};
}

Place anywhere(Random& random, const Yard& yard) {
  return {random.between(-yard.x, yard.x), random.between(-yard.z, yard.z),
          random.between(-kPi, kPi)};
}

// ---- things -------------------------------------------------------------------------------------

void add_barrel(Random& random, const Place& place, Snapshot& out) {
  const float radius = spread(random, 0.02F, 0.35F);
  const float reach = radius + spread(random, 0.1F, 1.2F);
  const bool lying = random.chance(0.35F);
  out.add(lying ? rod(place.at(-reach, radius, 0), place.at(reach, radius, 0), radius,
                      any_paint(random, out))
                : rod(place.at(0, 0, 0), place.at(0, reach, 0), radius, any_paint(random, out)));
}

// Wires and tubes across the ground or through the air.
void add_wire(Random& random, const Place& place, float height, Snapshot& out) {
  const float reach = random.between(0.3F, 2.5F);
  const float low = random.chance(0.6F) ? 0.02F : random.between(0, height);
  const float high = random.chance(0.6F) ? low : random.between(0, height);
  out.add(rod(place.at(-reach, low, 0), place.at(reach, high, random.between(-1, 1)),
              spread(random, 0.006F, 0.04F), any_paint(random, out)));
}

void add_partition(Random& random, const Place& place, float height, Snapshot& out) {
  const Vec3 half{random.between(0.2F, 1.6F), random.between(0.2F, 0.5F) * height,
                  random.between(0.02F, 0.15F)};
  out.add(box(place.at(0, half.y, 0), half, place.yaw, any_paint(random, out)));
}

void add_steps(Random& random, const Place& place, Snapshot& out) {
  const Paint stone = any_paint(random, out);
  const float rise = random.between(0.1F, 0.2F);
  const float width = random.between(0.3F, 1.2F);
  const int count = 2 + random.below(5);
  for (int i = 0; i < count; ++i) {
    const float up = rise * static_cast<float>(i + 1) / 2;
    out.add(
        box(place.at(0, up, 0.28F * static_cast<float>(i)), {width, up, 0.14F}, place.yaw, stone));
  }
}

// Flat on the ground: paint, not a thing.
void add_mat(Random& random, const Place& place, Snapshot& out) {
  out.add(shadowless(box({place.x, -0.004F, place.z},
                         {random.between(0.2F, 1.5F), 0.006F, random.between(0.2F, 1.5F)},
                         place.yaw, any_paint(random, out))));
}

void add_ball(Random& random, const Place& place, Snapshot& out) {
  const float radius = spread(random, 0.04F, 0.5F);
  const float up = random.chance(0.8F) ? radius : random.between(radius, 2);
  out.add(sphere(place.at(0, up, 0), radius, any_paint(random, out)));
}

// What is found under a roof and outside.
void add_any_thing(Random& random, const Place& place, float height, Snapshot& out) {
  switch (random.below(10)) {
    case 0:
    case 1:
    case 2:
      return add_boxes(random, place, out);
    case 3:
      return add_barrel(random, place, out);
    case 4:
      return add_wire(random, place, height, out);
    case 5:
      return add_mat(random, place, out);
    case 6:
      return add_ball(random, place, out);
    case 7:
      return add_person(out, random, place, random.between(0, 6.28F), random.unit());
    case 8:
      return random.chance(0.6F) ? add_partition(random, place, height, out)
                                 : add_steps(random, place, out);
    default:
      out.add(hoop(place.at(0, random.between(0.4F, 1.4F), 0), random.between(0.2F, 0.6F),
                   random.between(0.015F, 0.06F), place.yaw, any_paint(random, out)));
  }
}

void add_outdoor_thing(Random& random, const Place& place, Snapshot& out) {
  switch (random.below(12)) {
    case 0:
    case 1:
      return add_car(out, random, place);
    case 2:
      return add_house(out, random, place,
                       {1.5F * static_cast<float>(2 + random.below(3)),
                        1.5F * static_cast<float>(1 + random.below(4)),
                        1.5F * static_cast<float>(2 + random.below(4))});
    case 3:
      return add_tree(out, random, place, random.between(0.7F, 2));
    case 4:
      return add_pine(out, random, place, random.between(0.8F, 2.4F));
    case 5:
      return random.chance(0.5F) ? add_bush(out, random, place) : add_bench(out, place);
    case 6:
      return add_fence(out, place, random.between(3, 14), any_paint(random, out));
    case 7:
      return random.chance(0.5F) ? add_lamp_post(out, place) : add_sign(out, random, place);
    case 8:
      return add_gate(out, random, place, random.between(0.6F, 1.8F));
    default:
      return add_any_thing(random, place, 4, out);
  }
}

// ---- the eye ------------------------------------------------------------------------------------

// Distance from a point to a primitive's surface, or less; negative inside.
float clearance(const Primitive& p, Vec3 at) {
  const Vec3 v = at - p.centre;
  switch (p.shape) {
    case Shape::kBox: {
      const float x = std::abs(p.cos_yaw * v.x - p.sin_yaw * v.z) - p.half.x;
      const float z = std::abs(p.sin_yaw * v.x + p.cos_yaw * v.z) - p.half.z;
      return std::max({x, std::abs(v.y) - p.half.y, z});
    }
    case Shape::kCapsule: {
      const float along = std::clamp(dot(v, p.half) / dot(p.half, p.half), -1.0F, 1.0F);
      return length(v - p.half * along) - p.radius;
    }
    default:
      return length(v) - p.bound;
  }
}

// Looks from a place in the yard that has `distance` metres of air around it, if one is found, at
// `lowest` to `highest` metres above the ground.
void place_eye(Random& random, const Yard& yard, float lowest, float highest, float distance,
               Snapshot& out) {
  constexpr int kTries = 60;
  Vec3 eye;
  for (int i = 0; i < kTries; ++i) {
    eye = {random.between(-yard.x, yard.x), -spread(random, lowest, highest),
           random.between(-yard.z, yard.z)};
    if (is_free(out, eye, distance)) break;
  }
  // At something in the yard rather than at the wall beside.
  const Vec3 target{random.between(-yard.x, yard.x), 0, random.between(-yard.z, yard.z)};
  const float yaw = std::atan2(target.x - eye.x, target.z - eye.z);
  const float down =
      random.chance(0.7F) ? random.between(-0.1F, 0.35F) : random.between(-0.4F, 0.9F);
  const float roll = random.chance(0.5F) ? 0 : random.between(-0.2F, 0.2F);
  set_camera(eye, yaw, down, roll, out);
}

// A few things in front of the eye, `nearest` to `farthest` metres away; none that it would be in.
template <typename AddThing>
void add_in_view(Random& random, float nearest, float farthest, AddThing add_thing, Snapshot& out) {
  const float yaw = std::atan2(out.axes[2].x, out.axes[2].z);
  const int count = random.below(5);
  for (int i = 0; i < count; ++i) {
    const Place towards{out.eye.x, out.eye.z, yaw + random.between(-0.6F, 0.6F)};
    const Vec3 at = towards.at(0, 0, spread(random, nearest, farthest));
    const std::size_t before = out.count;
    add_thing(Place{at.x, at.z, random.between(-kPi, kPi)});
    const auto added = out.primitives().subspan(before);
    const bool clear = std::all_of(added.begin(), added.end(), [&](const Primitive& p) {
      return clearance(p, out.eye) > 0.2F;
    });
    if (!clear) out.count = before;
  }
}

// ---- the two kinds ------------------------------------------------------------------------------

Yard make_room(Random& random, Snapshot& out) {
  const bool corridor = random.chance(0.15F);
  out.indoor = true;
  out.room = {corridor ? random.between(0.8F, 1.2F) : spread(random, 1.3F, 5),
              random.between(2.2F, 3.6F), spread(random, corridor ? 3.0F : 1.3F, 9)};
  static constexpr std::array<Texture, 5> kFloors{
      Texture::kPlanks, Texture::kTiles, Texture::kConcrete, Texture::kWeave, Texture::kPlain};
  out.floor = kFloors[static_cast<std::size_t>(random.below(5))];
  if (out.photographs > 0 && random.chance(0.4F)) {
    out.floor = photograph(random.below(out.photographs));
  }
  std::array<Paint, 4> walls;
  walls.fill(paint(Texture::kPlaster, any_colour(random), 0.9F));
  for (Paint& wall : walls) {
    if (random.chance(0.25F) || (out.photographs > 0 && random.chance(0.3F))) {
      wall = any_paint(random, out);
    }
  }
  add_walls(walls, out);
  const Yard yard{out.room.x - 0.3F, out.room.z - 0.3F};
  out.sun = {random.between(-yard.x, yard.x), 0.3F - out.room.y, random.between(-yard.z, yard.z)};
  const float lamp = random.between(0.3F, 1.1F);
  out.sun_colour = mix({0.98F, 0.86F, 0.66F}, {0.9F, 0.95F, 1}, random.unit()) * lamp;
  out.sky_colour = Vec3{0.52F, 0.52F, 0.53F} * random.between(0.6F, 1.4F);
  out.haze = 0;
  return yard;
}

Yard fill_indoors(Random& shell, Random& things, Snapshot& out) {
  const Yard yard = make_room(shell, out);
  for (int i = 0; i < 4; ++i) {
    const Wall wall = wall_of(out.room, i);
    for (const float side : {-0.5F, 0.5F}) {
      if (wall.half < 0.9F || things.chance(0.4F)) continue;
      furnish(things, wall, side * wall.half, things.below(kPieces), out);
    }
  }
  const float area = 4 * yard.x * yard.z;
  const int count = 2 + things.below(3 + static_cast<int>(std::min(24.0F, area)));
  for (int i = 0; i < count; ++i) {
    add_indoor_thing(things, anywhere(things, yard), out.room.y, out);
  }
  return yard;
}

Yard make_ground(Random& random, Snapshot& out) {
  out.indoor = false;
  static constexpr std::array<Texture, 6> kGrounds{Texture::kGrass,    Texture::kAsphalt,
                                                   Texture::kConcrete, Texture::kTiles,
                                                   Texture::kFoliage,  Texture::kPlanks};
  const int kind = random.below(4);
  out.ground = kind == 0 ? Ground::kStreet : (kind == 1 ? Ground::kPath : Ground::kFloor);
  out.floor = kGrounds[static_cast<std::size_t>(random.below(6))];
  const float bend = random.between(-0.5F, 0.5F);
  for (int i = 0; i < Snapshot::kLineCount; ++i) {
    out.centre_line[static_cast<std::size_t>(i)] =
        bend * static_cast<float>(i + Snapshot::kLineBegin);
  }
  const float azimuth = random.between(-kPi, kPi);
  out.sun = normalized({std::sin(azimuth), -random.between(0.3F, 1.6F), std::cos(azimuth)});
  out.sun_colour =
      mix({0.72F, 0.7F, 0.66F}, {0.86F, 0.68F, 0.47F}, random.unit()) * random.between(0.2F, 1.2F);
  out.sky_colour =
      mix({0.42F, 0.47F, 0.56F}, {0.5F, 0.5F, 0.5F}, random.unit()) * random.between(0.7F, 1.3F);
  out.haze_colour = mix({0.74F, 0.81F, 0.9F}, {0.9F, 0.82F, 0.74F}, random.unit());
  out.haze = 1 / spread(random, 60, 400);
  const float reach = spread(random, 6, 45);
  return {reach, reach};
}

Yard fill_outdoors(Random& shell, Random& things, Snapshot& out) {
  const Yard yard = make_ground(shell, out);
  const int count = 8 + things.below(40);
  for (int i = 0; i < count; ++i) add_outdoor_thing(things, anywhere(things, yard), out);
  return yard;
}

}  // namespace

void add_boxes(Random& random, const Place& place, Snapshot& out) {
  Vec3 half{spread(random, 0.05F, 0.7F), spread(random, 0.05F, 0.6F), spread(random, 0.05F, 0.7F)};
  float top = 0;
  const int storeys = 1 + (random.chance(0.3F) ? random.below(3) : 0);
  for (int i = 0; i < storeys; ++i) {
    out.add(box(place.at(0, top + half.y, 0), half, place.yaw + random.between(-0.3F, 0.3F),
                any_paint(random, out)));
    top += 2 * half.y;
    half = half * random.between(0.5F, 1);
  }
}

void add_indoor_thing(Random& random, const Place& place, float height, Snapshot& out) {
  switch (random.below(9)) {
    case 0:
    case 1:
      return add_chair(out, random, place);
    case 2:
      return add_table(
          out, random, place,
          {random.between(0.3F, 0.9F), random.between(0.4F, 0.9F), random.between(0.25F, 0.6F)});
    case 3:
      return random.chance(0.5F) ? add_sofa(out, random, place)
                                 : add_shelf(out, random, place, random.between(0.3F, 0.9F),
                                             random.between(0.8F, 2.1F));
    case 4:
      return random.chance(0.5F) ? add_plant(out, random, place)
                                 : add_floor_lamp(out, random, place);
    default:
      return add_any_thing(random, place, height, out);
  }
}

bool is_free(const Snapshot& snapshot, Vec3 point, float distance) {
  const auto all = snapshot.primitives();
  return std::all_of(all.begin(), all.end(),
                     [&](const Primitive& p) { return clearance(p, point) > distance; });
}

void fill_medley(std::uint64_t seed, int photographs, Snapshot& out) {
  Random shell(seed, kShell, 0);
  Random things(seed, kThings, 0);
  Random eye(seed, kEye, 0);
  out.count = 0;
  out.photographs = photographs;
  out.origin_z = 0;
  out.centre_line.fill(0);
  out.haze_colour = {0.8F, 0.8F, 0.8F};
  out.ground = Ground::kFloor;
  out.ground_light = any_colour(shell);
  out.ground_dark = out.ground_light * shell.between(0.5F, 0.9F);
  if (shell.chance(0.6F)) {
    const Yard yard = fill_indoors(shell, things, out);
    place_eye(eye, yard, 0.15F, std::min(2.2F, out.room.y - 0.3F), 0.25F, out);
    add_in_view(
        things, 0.7F, 3.5F,
        [&](const Place& place) { add_indoor_thing(things, place, out.room.y, out); }, out);
  } else {
    const Yard yard = fill_outdoors(shell, things, out);
    place_eye(eye, yard, 0.2F, 8, 0.6F, out);
    add_in_view(
        things, 2, 20, [&](const Place& place) { add_outdoor_thing(things, place, out); }, out);
  }
}

}  // namespace lcdm::scene
