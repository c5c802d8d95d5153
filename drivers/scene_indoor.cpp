// Rooms: four walls, furniture along them, somebody walking round a table.
#include <cmath>

#include "drivers/scene_parts.h"
#include "drivers/scene_places.h"

namespace lcdm::scene {
namespace {

constexpr float kPi = 3.14159265F;
constexpr float kWall = 0.1F;  // half thickness
enum Salt : std::uint64_t { kShell = 1, kFurniture, kGuests };

// A wall seen from inside: `along` metres to its right, the room's floor below.
struct Wall {
  Place middle;  // on the floor at the wall's foot, looking into the room
  float half;    // half its length
};

Wall wall_of(const Vec3& room, int number) {
  switch (number) {
    case 0:
      return {{0, room.z, kPi}, room.x};
    case 1:
      return {{room.x, 0, -kPi / 2}, room.z};
    case 2:
      return {{0, -room.z, 0}, room.x};
    default:
      return {{-room.x, 0, kPi / 2}, room.z};
  }
}

Place beside(const Wall& wall, float along, float off) {
  const Vec3 at = wall.middle.at(along, 0, off);
  return {at.x, at.z, wall.middle.yaw};
}

void add_shell(Random& random, Snapshot& out) {
  static constexpr Vec3 kColours[] = {{0.9F, 0.87F, 0.8F},
                                      {0.74F, 0.8F, 0.84F},
                                      {0.84F, 0.78F, 0.7F},
                                      {0.76F, 0.82F, 0.72F},
                                      {0.88F, 0.76F, 0.68F}};
  const Vec3 colour = kColours[random.below(5)];
  const int bricks = random.below(6);  // that wall, if there is one of the number
  for (int i = 0; i < 4; ++i) {
    const Wall wall = wall_of(out.room, i);
    const Paint surface = i == bricks ? paint(Texture::kBrick, {0.74F, 0.5F, 0.4F}, 0.7F)
                                      : paint(Texture::kPlaster, colour, 0.9F);
    const Vec3 at = wall.middle.at(0, out.room.y / 2, -kWall);
    out.add(shadowless(
        box(at, {wall.half + 2 * kWall, out.room.y / 2, kWall}, wall.middle.yaw, surface)));
    out.add(shadowless(box(wall.middle.at(0, 0.05F, 0), {wall.half, 0.05F, 0.015F}, wall.middle.yaw,
                           paint(Texture::kPlain, {0.93F, 0.92F, 0.9F}, 0.9F))));
  }
  out.add(shadowless(box({0, -out.room.y - kWall, 0}, {out.room.x + 0.2F, kWall, out.room.z + 0.2F},
                         0, paint(Texture::kPlaster, {0.93F, 0.92F, 0.9F}, 0.95F, 0.5F))));
}

void add_window(const Wall& wall, float along, Snapshot& out) {
  const Paint frame = paint(Texture::kPlain, {0.95F, 0.95F, 0.94F}, 0.9F);
  const float half = 0.7F;
  out.add(shadowless(box(wall.middle.at(along, 1.5F, 0.0F), {half, 0.62F, 0.012F}, wall.middle.yaw,
                         {Texture::kPlaster, {1.3F, 1.55F, 1.9F}, {1.8F, 1.8F, 1.8F}, 0.4F})));
  for (const float side : {-half, 0.0F, half}) {
    out.add(box(wall.middle.at(along + side, 1.5F, 0.01F), {0.035F, 0.66F, 0.035F}, wall.middle.yaw,
                frame));
  }
  for (const float up : {0.86F, 2.14F}) {
    out.add(box(wall.middle.at(along, up, 0.02F), {half + 0.07F, 0.035F, 0.05F}, wall.middle.yaw,
                frame));
  }
}

void add_door(const Wall& wall, float along, Snapshot& out) {
  out.add(box(wall.middle.at(along, 1.03F, 0), {0.47F, 1.03F, 0.025F}, wall.middle.yaw,
              paint(Texture::kPlain, {0.9F, 0.89F, 0.86F}, 0.9F)));
  out.add(box(wall.middle.at(along, 1.0F, 0.015F), {0.41F, 1.0F, 0.025F}, wall.middle.yaw,
              paint(Texture::kPlanks, {0.7F, 0.5F, 0.34F}, 0.75F)));
  out.add(sphere(wall.middle.at(along + 0.33F, 1.02F, 0.07F), 0.04F,
                 paint(Texture::kPlain, {0.85F, 0.75F, 0.4F}, 0.8F)));
}

void add_painting(Random& random, const Wall& wall, float along, Snapshot& out) {
  const Vec3 half{random.between(0.3F, 0.55F), random.between(0.25F, 0.4F), 0.02F};
  out.add(box(wall.middle.at(along, 1.65F, 0), {half.x + 0.05F, half.y + 0.05F, half.z},
              wall.middle.yaw, paint(Texture::kPlanks, {0.4F, 0.28F, 0.18F}, 0.7F)));
  const Vec3 low{random.between(0.1F, 0.6F), random.between(0.1F, 0.4F),
                 random.between(0.2F, 0.6F)};
  const Vec3 high{random.between(0.6F, 1.0F), random.between(0.5F, 0.9F),
                  random.between(0.3F, 0.8F)};
  out.add(box(wall.middle.at(along, 1.65F, 0.01F), half, wall.middle.yaw,
              {Texture::kPainting, low, high, random.between(0.8F, 1.3F)}));
}

// One piece of furniture against the wall, and something above it.
void furnish(Random& random, const Wall& wall, float along, int piece, Snapshot& out) {
  switch (piece) {
    case 0:
      add_shelf(out, random, beside(wall, along, 0.18F), 0.55F, random.between(1.5F, 2.1F));
      return;
    case 1:
      add_sofa(out, random, beside(wall, along, 0.55F));
      add_painting(random, wall, along, out);
      return;
    case 2:
      add_window(wall, along, out);
      add_plant(out, random, beside(wall, along + 0.4F, 0.32F));
      return;
    case 3:
      add_table(out, random, beside(wall, along, 0.42F), {0.6F, 0.74F, 0.34F});
      add_painting(random, wall, along, out);
      return;
    case 4:
      add_floor_lamp(out, random, beside(wall, along, 0.35F));
      add_painting(random, wall, along + 0.1F, out);
      return;
    default:
      add_door(wall, along, out);
  }
}

void add_furniture(Random& random, Snapshot& out) {
  // Two pieces along each wall, a window on the first two.
  for (int i = 0; i < 4; ++i) {
    const Wall wall = wall_of(out.room, i);
    const float at = wall.half * 0.46F;
    furnish(random, wall, -at, i < 2 ? 2 : random.below(2), out);
    furnish(random, wall, at, i == 2 ? 5 : random.below(5), out);
  }
  out.add(box({0, -0.004F, 0}, {1.25F, 0.006F, 1.0F}, random.between(-0.2F, 0.2F),
              {Texture::kWeave, {0.42F, 0.16F, 0.16F}, {0.76F, 0.55F, 0.4F}, 0.8F}));
  const Place centre{0, 0, random.between(-0.3F, 0.3F)};
  add_table(out, random, centre, {0.75F, 0.73F, 0.45F});
  for (int i = 0; i < 3; ++i) {
    const float yaw = centre.yaw + kPi / 2 * static_cast<float>(i + random.below(2));
    const float off = i % 2 == 0 ? 0.72F : 1.0F;
    const Vec3 at = Place{0, 0, yaw}.at(random.between(-0.2F, 0.2F), 0, -off);
    add_chair(out, random, {at.x, at.z, yaw + random.between(-0.2F, 0.2F)});
  }
  // The lamp over the table; its light starts just below it.
  out.add(shadowless(rod({0, -out.room.y, 0}, {0, -1.98F, 0}, 0.012F,
                         paint(Texture::kPlain, {0.2F, 0.2F, 0.2F}))));
  out.add(shadowless(
      sphere({0, -1.93F, 0}, 0.13F, paint(Texture::kPlain, {1.9F, 1.75F, 1.4F}, 0.98F))));
  // A gymnastics hoop leans in a corner.
  const float corner = random.chance(0.5F) ? 1.0F : -1.0F;
  const Vec3 at{corner * (out.room.x - 0.55F), 0, -(out.room.z - 0.55F)};
  out.add(hoop(at + Vec3{0, -0.47F, 0}, 0.42F, 0.022F, corner * 0.8F,
               {Texture::kStripes, {0.9F, 0.35F, 0.2F}, {0.95F, 0.9F, 0.85F}, 2}));
}

}  // namespace

void fill_room(std::uint64_t seed, double seconds, Snapshot& out) {
  Random shell(seed, kShell, 0);
  out.indoor = true;
  out.origin_z = 0;
  out.centre_line.fill(0);
  out.room = {shell.between(3.4F, 4.4F), shell.between(2.6F, 2.9F), shell.between(3.4F, 4.8F)};
  out.ground = Ground::kFloor;
  out.floor = shell.chance(0.6F) ? Texture::kPlanks : Texture::kTiles;
  const Vec3 floor = mix({0.5F, 0.36F, 0.25F}, {0.8F, 0.68F, 0.52F}, shell.unit());
  out.ground_light = floor;
  out.ground_dark = floor * 0.62F;
  out.sun = {0, -1.76F, 0};
  out.sun_colour = {0.98F, 0.9F, 0.76F};
  out.sky_colour = {0.52F, 0.52F, 0.53F};
  out.haze_colour = {0.8F, 0.8F, 0.8F};
  out.haze = 0;
  add_shell(shell, out);
  Random furniture(seed, kFurniture, 0);
  add_furniture(furniture, out);

  const auto wave = [seconds](double rate) { return static_cast<float>(std::sin(rate * seconds)); };
  const auto turn = static_cast<float>(std::fmod(0.16 * seconds, 2.0 * kPi));
  const float wide = out.room.x - 1.35F;
  const float deep = out.room.z - 1.35F;
  const Vec3 eye{wide * std::sin(turn), -1.45F - 0.12F * wave(0.37), -deep * std::cos(turn)};
  const Vec3 target{0.9F * wave(0.23), -0.95F, 0.9F * wave(0.29)};
  const Vec3 ahead = target - eye;
  set_camera(eye, std::atan2(ahead.x, ahead.z), std::atan2(ahead.y, std::hypot(ahead.x, ahead.z)),
             0.02F * wave(0.41), out);

  // Somebody walks round the table on the other side, a ball bounces in a corner.
  Random guests(seed, kGuests, 0);
  const double walked = 0.16 * seconds + 0.5 * std::sin(0.21 * seconds);
  const auto walk = static_cast<float>(std::fmod(walked + kPi, 2.0 * kPi));
  const auto phase = static_cast<float>(std::fmod(13.0 * walked, 2.0 * kPi));
  const Place person{wide * std::sin(walk), -deep * std::cos(walk), kPi / 2 - walk};
  add_person(out, guests, person, phase, 0.8F);
  const float hop = std::abs(wave(2.2));
  out.add(sphere({out.room.x - 0.75F, -0.14F - 0.8F * hop, out.room.z - 0.8F}, 0.14F,
                 {Texture::kStripes, {0.85F, 0.25F, 0.2F}, {0.95F, 0.95F, 0.9F}, 2.5F}));
}

}  // namespace lcdm::scene
