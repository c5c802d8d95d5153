// The things a scene is furnished with, built from primitives. All stand on y = 0.
#pragma once

#include "drivers/scene/scene.h"

namespace lcdm::scene {

// ---- single primitives; `dark` and `light` are the texture's colours ----------------------------

struct Paint {
  Texture texture = Texture::kPlain;
  Vec3 dark;
  Vec3 light;
  float scale = 1;
};

// A paint whose dark colour is `shade` of the light one.
Paint paint(Texture texture, Vec3 light, float shade = 0.6F, float scale = 1);

Primitive sphere(Vec3 centre, float radius, const Paint& paint);
Primitive box(Vec3 centre, Vec3 half, float yaw, const Paint& paint);
Primitive rod(Vec3 from, Vec3 to, float radius, const Paint& paint);
Primitive hoop(Vec3 centre, float ring, float tube, float yaw, const Paint& paint);
// The same without a shadow: for what hugs a wall, or shines.
Primitive shadowless(Primitive primitive);

// ---- things -------------------------------------------------------------------------------------

// Where a thing stands and which way its own +z looks.
struct Place {
  float x = 0;
  float z = 0;
  float yaw = 0;

  // The world point at the place's own right, height (up), forward.
  Vec3 at(float right, float up, float forward) const;
};

void add_tree(Snapshot& out, Random& random, const Place& place, float size);
void add_pine(Snapshot& out, Random& random, const Place& place, float size);
void add_bush(Snapshot& out, Random& random, const Place& place);
void add_lamp_post(Snapshot& out, const Place& place);
void add_sign(Snapshot& out, Random& random, const Place& place);
void add_bench(Snapshot& out, const Place& place);
void add_car(Snapshot& out, Random& random, const Place& place);
void add_house(Snapshot& out, Random& random, const Place& place, Vec3 half);
void add_fence(Snapshot& out, const Place& place, float length, const Paint& paint);
// A gate to fly through: a hoop on a pole.
void add_gate(Snapshot& out, Random& random, const Place& place, float ring);
// `phase` in radians: one step pair per turn. Standing still when `stride` is 0.
void add_person(Snapshot& out, Random& random, const Place& place, float phase, float stride);

void add_table(Snapshot& out, Random& random, const Place& place, Vec3 half);
void add_chair(Snapshot& out, Random& random, const Place& place);
void add_shelf(Snapshot& out, Random& random, const Place& place, float half_width, float height);
void add_sofa(Snapshot& out, Random& random, const Place& place);
void add_floor_lamp(Snapshot& out, Random& random, const Place& place);
void add_plant(Snapshot& out, Random& random, const Place& place);

}  // namespace lcdm::scene
