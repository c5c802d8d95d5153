#include "drivers/scene/parts.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace lcdm::scene {
namespace {

constexpr Vec3 kGlass{0.16F, 0.2F, 0.25F};
constexpr Vec3 kSteel{0.5F, 0.52F, 0.55F};

Primitive turned(Primitive p, float yaw) {
  p.cos_yaw = std::cos(yaw);
  p.sin_yaw = std::sin(yaw);
  return p;
}

Primitive painted(Shape shape, Vec3 centre, const Paint& paint) {
  Primitive p;
  p.shape = shape;
  p.centre = centre;
  p.texture = paint.texture;
  p.dark = paint.dark;
  p.light = paint.light;
  p.scale = paint.scale;
  return p;
}

Vec3 leaf_colour(Random& random) {
  return {random.between(0.3F, 0.55F), random.between(0.5F, 0.66F), random.between(0.16F, 0.26F)};
}

Vec3 cloth_colour(Random& random) {
  static constexpr std::array<Vec3, 8> kCloth{{{0.72F, 0.2F, 0.18F},
                                               {0.2F, 0.34F, 0.62F},
                                               {0.86F, 0.74F, 0.3F},
                                               {0.25F, 0.5F, 0.38F},
                                               {0.8F, 0.8F, 0.78F},
                                               {0.3F, 0.3F, 0.34F},
                                               {0.75F, 0.45F, 0.25F},
                                               {0.52F, 0.32F, 0.55F}}};
  return kCloth[static_cast<std::size_t>(random.below(8))];
}

Vec3 wood_colour(Random& random) {
  return mix({0.42F, 0.27F, 0.16F}, {0.8F, 0.62F, 0.42F}, random.unit());
}

}  // namespace

Paint paint(Texture texture, Vec3 light, float shade, float scale) {
  return {texture, light * shade, light, scale};
}

Primitive sphere(Vec3 centre, float radius, const Paint& paint) {
  Primitive p = painted(Shape::kSphere, centre, paint);
  p.radius = radius;
  p.bound = radius;
  return p;
}

Primitive box(Vec3 centre, Vec3 half, float yaw, const Paint& paint) {
  Primitive p = turned(painted(Shape::kBox, centre, paint), yaw);
  p.half = half;
  p.bound = length(half);
  return p;
}

Primitive rod(Vec3 from, Vec3 to, float radius, const Paint& paint) {
  Primitive p = painted(Shape::kCapsule, (from + to) * 0.5F, paint);
  p.half = (to - from) * 0.5F;
  p.radius = radius;
  p.bound = length(p.half) + radius;
  return p;
}

Primitive hoop(Vec3 centre, float ring, float tube, float yaw, const Paint& paint) {
  Primitive p = turned(painted(Shape::kHoop, centre, paint), yaw);
  p.half.x = ring;
  p.radius = tube;
  p.bound = ring + tube;
  return p;
}

Primitive shadowless(Primitive primitive) {
  primitive.casts_shadow = false;
  return primitive;
}

Vec3 Place::at(float right, float up, float forward) const {
  const float c = std::cos(yaw);
  const float s = std::sin(yaw);
  return {x + c * right + s * forward, -up, z - s * right + c * forward};
}

void add_tree(Snapshot& out, Random& random, const Place& place, float size) {
  const Vec3 leaves = leaf_colour(random);
  const float trunk = 1.7F * size;
  out.add(rod(place.at(0, -0.2F, 0), place.at(0.1F * size, trunk, 0), 0.13F * size,
              paint(Texture::kBark, {0.5F, 0.4F, 0.3F}, 0.5F)));
  constexpr int kCrowns = 6;
  for (int i = 0; i < kCrowns; ++i) {
    const float angle = 2 * kPi * (static_cast<float>(i) + random.unit() * 0.6F) / (kCrowns - 1);
    const bool top = i == kCrowns - 1;
    const float out_by = top ? 0 : random.between(0.5F, 0.75F) * size;
    const float up = trunk + (top ? 1.35F : random.between(0.25F, 0.8F)) * size;
    const float radius = random.between(0.68F, 0.9F) * size;
    out.add(sphere(place.at(std::cos(angle) * out_by, up, std::sin(angle) * out_by), radius,
                   paint(Texture::kFoliage, leaves * random.between(0.85F, 1.1F), 0.42F)));
  }
}

void add_pine(Snapshot& out, Random& random, const Place& place, float size) {
  const Vec3 needles{random.between(0.2F, 0.3F), random.between(0.4F, 0.5F), 0.24F};
  out.add(rod(place.at(0, -0.2F, 0), place.at(0, size, 0), 0.12F * size,
              paint(Texture::kBark, {0.45F, 0.33F, 0.25F}, 0.5F)));
  for (int i = 0; i < 4; ++i) {
    const auto level = static_cast<float>(i);
    out.add(sphere(place.at(0, size * (1.05F + 0.62F * level), 0), size * (0.82F - 0.19F * level),
                   paint(Texture::kFoliage, needles, 0.4F, 1.3F)));
  }
}

void add_bush(Snapshot& out, Random& random, const Place& place) {
  const Vec3 leaves = leaf_colour(random);
  for (int i = 0; i < 3; ++i) {
    const float radius = random.between(0.35F, 0.6F);
    out.add(
        sphere(place.at(random.between(-0.5F, 0.5F), radius * 0.6F, random.between(-0.4F, 0.4F)),
               radius, paint(Texture::kFoliage, leaves, 0.45F, 1.4F)));
  }
}

void add_lamp_post(Snapshot& out, const Place& place) {
  const Paint steel = paint(Texture::kPlain, {0.3F, 0.33F, 0.35F}, 0.8F);
  out.add(rod(place.at(0, -0.2F, 0), place.at(0, 5.2F, 0), 0.075F, steel));
  out.add(rod(place.at(0, 5.2F, 0), place.at(1.3F, 5.45F, 0), 0.05F, steel));
  out.add(box(place.at(1.4F, 5.42F, 0), {0.3F, 0.06F, 0.12F}, place.yaw,
              paint(Texture::kPlain, {0.9F, 0.9F, 0.85F}, 0.9F)));
}

void add_sign(Snapshot& out, Random& random, const Place& place) {
  const Vec3 face = random.chance(0.5F) ? Vec3{0.15F, 0.35F, 0.7F} : Vec3{0.85F, 0.2F, 0.16F};
  out.add(rod(place.at(0, -0.2F, 0), place.at(0, 2.7F, 0), 0.04F,
              paint(Texture::kPlain, kSteel, 0.8F)));
  out.add(box(place.at(0, 2.4F, -0.06F), {0.33F, 0.33F, 0.015F}, place.yaw,
              {Texture::kStripes, face, {0.94F, 0.94F, 0.94F}, 0.7F}));
}

void add_bench(Snapshot& out, const Place& place) {
  const Paint wood = paint(Texture::kPlanks, {0.62F, 0.42F, 0.26F}, 0.55F, 1.5F);
  const Paint iron = paint(Texture::kPlain, {0.22F, 0.23F, 0.25F});
  out.add(box(place.at(0, 0.46F, 0), {0.85F, 0.035F, 0.22F}, place.yaw, wood));
  out.add(box(place.at(0, 0.76F, -0.24F), {0.85F, 0.18F, 0.03F}, place.yaw, wood));
  for (const float side : {-0.65F, 0.65F}) {
    out.add(box(place.at(side, 0.22F, 0), {0.04F, 0.22F, 0.2F}, place.yaw, iron));
  }
}

void add_car(Snapshot& out, Random& random, const Place& place) {
  const Paint body = paint(Texture::kPlain, cloth_colour(random), 0.85F);
  const Paint dark = paint(Texture::kPlain, {0.1F, 0.1F, 0.11F}, 0.7F);
  out.add(box(place.at(0, 0.62F, 0), {0.86F, 0.3F, 2.05F}, place.yaw, body));
  out.add(box(place.at(0, 1.13F, -0.25F), {0.74F, 0.26F, 1.15F}, place.yaw,
              paint(Texture::kPlain, kGlass, 0.8F)));
  out.add(box(place.at(0, 1.4F, -0.3F), {0.72F, 0.03F, 1.0F}, place.yaw, body));
  for (const float forward : {-1.25F, 1.3F}) {
    for (const float side : {-1.0F, 1.0F}) {
      out.add(rod(place.at(side * 0.66F, 0.33F, forward), place.at(side * 0.74F, 0.33F, forward),
                  0.33F, dark));
    }
  }
  for (const float side : {-0.62F, 0.62F}) {
    out.add(sphere(place.at(side, 0.7F, 2.02F), 0.12F,
                   paint(Texture::kPlain, {0.97F, 0.96F, 0.86F}, 0.95F)));
    out.add(box(place.at(side, 0.75F, -2.05F), {0.16F, 0.07F, 0.02F}, place.yaw,
                paint(Texture::kPlain, {0.75F, 0.1F, 0.08F}, 0.9F)));
  }
}

void add_house(Snapshot& out, Random& random, const Place& place, Vec3 half) {
  static constexpr std::array<Vec3, 7> kWalls{{{0.83F, 0.76F, 0.63F},
                                               {0.72F, 0.44F, 0.34F},
                                               {0.85F, 0.82F, 0.78F},
                                               {0.66F, 0.68F, 0.7F},
                                               {0.82F, 0.66F, 0.44F},
                                               {0.58F, 0.64F, 0.6F},
                                               {0.76F, 0.6F, 0.55F}}};
  const Vec3 wall = kWalls[static_cast<std::size_t>(random.below(7))];
  const bool brick = random.chance(0.3F);
  const float plinth = 0.45F;
  // Upper floors with windows on a plain or brick ground floor, a cornice on top.
  const float ground_floor = brick ? 2.6F : plinth;
  out.add(box(place.at(0, ground_floor / 2, 0), {half.x + 0.06F, ground_floor / 2, half.z + 0.06F},
              place.yaw,
              brick ? paint(Texture::kBrick, {0.66F, 0.4F, 0.32F}, 0.55F)
                    : paint(Texture::kConcrete, wall * 0.7F, 0.7F)));
  const float storeys = half.y;
  out.add(box(place.at(0, ground_floor + storeys, 0), {half.x, storeys, half.z}, place.yaw,
              {Texture::kFacade, kGlass, wall, 1}));
  const Vec3 roof = random.chance(0.5F) ? Vec3{0.5F, 0.26F, 0.2F} : Vec3{0.34F, 0.35F, 0.38F};
  out.add(box(place.at(0, ground_floor + 2 * half.y + 0.15F, 0),
              {half.x + 0.35F, 0.15F, half.z + 0.35F}, place.yaw,
              paint(Texture::kConcrete, roof, 0.75F)));
  if (random.chance(0.5F)) {
    out.add(box(place.at(half.x * 0.4F, ground_floor + 2 * half.y + 0.8F, 0), {0.35F, 0.7F, 0.35F},
                place.yaw, paint(Texture::kBrick, {0.6F, 0.35F, 0.28F}, 0.6F)));
  }
}

void add_fence(Snapshot& out, const Place& place, float length, const Paint& paint) {
  constexpr float kGap = 2;
  const int posts = static_cast<int>(std::ceil(length / kGap));
  for (int i = 0; i < posts; ++i) {
    const float along = kGap * static_cast<float>(i);
    out.add(box(place.at(0, 0.45F, along), {0.05F, 0.5F, 0.05F}, place.yaw, paint));
  }
  for (const float up : {0.42F, 0.78F}) {
    out.add(box(place.at(0, up, length / 2), {0.025F, 0.06F, length / 2}, place.yaw, paint));
  }
}

void add_gate(Snapshot& out, Random& random, const Place& place, float ring) {
  const float centre = ring + 0.75F;
  const Vec3 colour = random.chance(0.5F) ? Vec3{0.95F, 0.5F, 0.12F} : Vec3{0.15F, 0.5F, 0.85F};
  out.add(hoop(place.at(0, centre, 0), ring, 0.08F, place.yaw,
               {Texture::kStripes, colour, {0.95F, 0.95F, 0.93F}, 1}));
  out.add(rod(place.at(0, -0.2F, 0), place.at(0, centre - ring, 0), 0.05F,
              paint(Texture::kPlain, kSteel, 0.8F)));
}

void add_person(Snapshot& out, Random& random, const Place& place, float phase, float stride) {
  const float size = random.between(0.92F, 1.06F);
  const Paint coat = paint(Texture::kWeave, cloth_colour(random), 0.7F, 2);
  const Paint trousers = paint(Texture::kWeave, cloth_colour(random) * 0.6F, 0.7F, 2);
  const Vec3 tone = mix({0.42F, 0.28F, 0.2F}, {0.93F, 0.74F, 0.62F}, random.unit());
  const Paint skin = paint(Texture::kPlain, tone, 0.85F);
  const Vec3 hair = mix({0.12F, 0.09F, 0.07F}, {0.7F, 0.55F, 0.35F}, random.unit());
  const float hip = 0.88F * size;
  const float shoulder = 1.42F * size;
  out.add(rod(place.at(0, hip, 0), place.at(0, shoulder - 0.1F, 0), 0.17F * size, coat));
  out.add(sphere(place.at(0, 1.63F * size, 0.02F), 0.125F * size, skin));
  out.add(
      sphere(place.at(0, 1.67F * size, -0.02F), 0.125F * size, paint(Texture::kPlain, hair, 0.7F)));
  for (const float side : {-1.0F, 1.0F}) {
    const float swing = std::sin(phase + (side > 0 ? kPi : 0)) * stride;
    const float lift = std::max(0.0F, std::cos(phase + (side > 0 ? kPi : 0))) * 0.1F * stride;
    out.add(rod(place.at(side * 0.1F, hip, 0), place.at(side * 0.1F, 0.08F + lift, swing * 0.4F),
                0.085F * size, trousers));
    out.add(rod(place.at(side * 0.22F, shoulder - 0.08F, 0),
                place.at(side * 0.27F, 0.82F * size, -swing * 0.32F), 0.06F * size, coat));
  }
}

void add_table(Snapshot& out, Random& random, const Place& place, Vec3 half) {
  const Paint wood = paint(Texture::kPlanks, wood_colour(random), 0.6F, 1.6F);
  out.add(box(place.at(0, half.y, 0), {half.x, 0.03F, half.z}, place.yaw, wood));
  for (const float right : {-1.0F, 1.0F}) {
    for (const float forward : {-1.0F, 1.0F}) {
      out.add(box(place.at(right * (half.x - 0.07F), half.y / 2, forward * (half.z - 0.07F)),
                  {0.035F, half.y / 2, 0.035F}, place.yaw, wood));
    }
  }
  // Something on it: a bowl of fruit, a book or a vase.
  const float top = half.y + 0.03F;
  out.add(sphere(place.at(-0.2F, top + 0.1F, 0.05F), 0.1F,
                 paint(Texture::kPlain, {0.85F, 0.3F, 0.15F}, 0.7F)));
  out.add(sphere(place.at(-0.02F, top + 0.08F, -0.08F), 0.08F,
                 paint(Texture::kPlain, {0.75F, 0.7F, 0.2F}, 0.7F)));
  out.add(box(place.at(0.35F, top + 0.025F, 0), {0.12F, 0.025F, 0.17F}, place.yaw + 0.4F,
              paint(Texture::kStripes, cloth_colour(random), 0.6F, 0.5F)));
}

void add_chair(Snapshot& out, Random& random, const Place& place) {
  const Paint wood = paint(Texture::kPlanks, wood_colour(random), 0.65F, 2);
  const Paint seat = paint(Texture::kWeave, cloth_colour(random), 0.7F, 2);
  out.add(box(place.at(0, 0.46F, 0), {0.22F, 0.03F, 0.22F}, place.yaw, seat));
  out.add(box(place.at(0, 0.84F, -0.2F), {0.2F, 0.13F, 0.02F}, place.yaw, wood));
  for (const float right : {-0.19F, 0.19F}) {
    out.add(rod(place.at(right, 0, 0.19F), place.at(right, 0.44F, 0.19F), 0.022F, wood));
    out.add(rod(place.at(right, 0, -0.2F), place.at(right, 0.92F, -0.2F), 0.022F, wood));
  }
}

void add_shelf(Snapshot& out, Random& random, const Place& place, float half_width, float height) {
  const Paint wood = paint(Texture::kPlanks, wood_colour(random), 0.65F, 1.5F);
  const float depth = 0.16F;
  for (const float side : {-1.0F, 1.0F}) {
    out.add(box(place.at(side * half_width, height / 2, 0), {0.02F, height / 2, depth}, place.yaw,
                wood));
  }
  const int boards = std::max(2, static_cast<int>(height / 0.42F));
  for (int i = 0; i <= boards; ++i) {
    const float up = 0.06F + (height - 0.08F) * static_cast<float>(i) / static_cast<float>(boards);
    out.add(box(place.at(0, up, 0), {half_width, 0.016F, depth}, place.yaw, wood));
    if (i == boards || random.chance(0.15F)) continue;
    const float fill = random.between(0.45F, 0.95F) * half_width;
    out.add(box(place.at(fill - half_width + 0.03F, up + 0.15F, 0), {fill, 0.13F, depth * 0.7F},
                place.yaw, {Texture::kBooks, {0.5F, 0.2F, 0.18F}, {0.82F, 0.78F, 0.62F}, 1}));
  }
}

void add_sofa(Snapshot& out, Random& random, const Place& place) {
  const Paint cloth = paint(Texture::kWeave, cloth_colour(random), 0.7F);
  out.add(box(place.at(0, 0.22F, 0), {0.95F, 0.2F, 0.42F}, place.yaw, cloth));
  out.add(box(place.at(0, 0.58F, -0.36F), {0.95F, 0.25F, 0.11F}, place.yaw, cloth));
  for (const float side : {-1.0F, 1.0F}) {
    out.add(box(place.at(side * 0.9F, 0.42F, 0), {0.1F, 0.2F, 0.42F}, place.yaw, cloth));
  }
  out.add(sphere(place.at(0.55F, 0.55F, -0.16F), 0.17F,
                 paint(Texture::kStripes, cloth_colour(random), 0.6F, 2)));
}

void add_floor_lamp(Snapshot& out, Random& random, const Place& place) {
  const Paint steel = paint(Texture::kPlain, kSteel, 0.8F);
  out.add(rod(place.at(0, 0.02F, 0), place.at(0, 1.6F, 0), 0.018F, steel));
  out.add(rod(place.at(-0.1F, 0.02F, 0), place.at(0.1F, 0.02F, 0), 0.06F, steel));
  out.add(shadowless(sphere(place.at(0, 1.66F, 0), random.between(0.15F, 0.22F),
                            paint(Texture::kPlain, {1.7F, 1.5F, 1.15F}, 0.97F))));
}

void add_plant(Snapshot& out, Random& random, const Place& place) {
  out.add(rod(place.at(0, 0.12F, 0), place.at(0, 0.26F, 0), 0.15F,
              paint(Texture::kConcrete, {0.78F, 0.5F, 0.36F}, 0.8F)));
  out.add(rod(place.at(0, 0.3F, 0), place.at(0, 0.75F, 0), 0.02F,
              paint(Texture::kBark, {0.4F, 0.35F, 0.25F})));
  const Vec3 leaves{random.between(0.2F, 0.35F), random.between(0.48F, 0.6F), 0.25F};
  for (int i = 0; i < 5; ++i) {
    const float angle = random.between(0, 2 * kPi);
    const float out_by = random.between(0.1F, 0.24F);
    out.add(sphere(
        place.at(std::cos(angle) * out_by, random.between(0.6F, 1.15F), std::sin(angle) * out_by),
        random.between(0.13F, 0.22F), paint(Texture::kFoliage, leaves, 0.45F, 2.5F)));
  }
}

}  // namespace lcdm::scene
