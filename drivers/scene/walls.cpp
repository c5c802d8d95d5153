#include "drivers/scene/walls.h"

namespace lcdm::scene {
namespace {

constexpr float kWall = 0.1F;  // half thickness, metres

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

}  // namespace

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

void add_walls(const std::array<Paint, 4>& paints, Snapshot& out) {
  for (int i = 0; i < 4; ++i) {
    const Wall wall = wall_of(out.room, i);
    const Vec3 at = wall.middle.at(0, out.room.y / 2, -kWall);
    out.add(shadowless(box(at, {wall.half + 2 * kWall, out.room.y / 2, kWall}, wall.middle.yaw,
                           paints[static_cast<std::size_t>(i)])));
    out.add(shadowless(box(wall.middle.at(0, 0.05F, 0), {wall.half, 0.05F, 0.015F}, wall.middle.yaw,
                           paint(Texture::kPlain, {0.93F, 0.92F, 0.9F}, 0.9F))));
  }
  out.add(shadowless(box({0, -out.room.y - kWall, 0}, {out.room.x + 0.2F, kWall, out.room.z + 0.2F},
                         0, paint(Texture::kPlaster, {0.93F, 0.92F, 0.9F}, 0.95F, 0.5F))));
}

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

}  // namespace lcdm::scene
