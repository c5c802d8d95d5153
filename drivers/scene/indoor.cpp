// Rooms: four walls, furniture along them, somebody walking round a table.
#include <array>
#include <cmath>

#include "drivers/scene/places.h"
#include "drivers/scene/walls.h"

namespace lcdm::scene {
namespace {

enum Salt : std::uint64_t { kShell = 1, kFurniture, kGuests };

void add_shell(Random& random, Snapshot& out) {
  static constexpr Vec3 kColours[] = {{0.9F, 0.87F, 0.8F},
                                      {0.74F, 0.8F, 0.84F},
                                      {0.84F, 0.78F, 0.7F},
                                      {0.76F, 0.82F, 0.72F},
                                      {0.88F, 0.76F, 0.68F}};
  std::array<Paint, 4> paints;
  paints.fill(paint(Texture::kPlaster, kColours[random.below(5)], 0.9F));
  const int bricks = random.below(6);  // that wall, if there is one of the number
  if (bricks < 4) {
    paints[static_cast<std::size_t>(bricks)] = paint(Texture::kBrick, {0.74F, 0.5F, 0.4F}, 0.7F);
  }
  add_walls(paints, out);
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
