// A small world to look at: what stands where at a given time. Rendered by render.cpp.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "drivers/scene/math.h"

namespace lcdm::scene {

enum class Shape : std::uint8_t {
  kSphere,
  kBox,      // turned about the vertical
  kCapsule,  // a rod with round ends, in any direction
  kHoop,     // an upright torus, turned about the vertical
};

enum class Texture : std::uint8_t {
  kPlain,
  kPlaster,
  kBrick,
  kPlanks,
  kWeave,
  kGrass,
  kAsphalt,
  kFoliage,
  kBark,
  kFacade,
  kTiles,
  kConcrete,
  kBooks,
  kPainting,
  kStripes,
};
constexpr int kTextures = 15;
// Texture number `index` of the photographs in textures.h.
constexpr Texture photograph(int index) { return static_cast<Texture>(kTextures + index); }

struct Primitive {
  Shape shape = Shape::kSphere;
  Texture texture = Texture::kPlain;
  Vec3 centre;
  Vec3 half;  // box: half sizes; capsule: from the centre to one end's; hoop: x = ring radius
  float radius = 0;   // sphere, capsule; hoop: of the tube
  float cos_yaw = 1;  // box, hoop: world x, z = turn by yaw of the local ones
  float sin_yaw = 0;
  float scale = 1;  // texture repeats at 1 / scale of its usual size
  Vec3 dark;        // the texture's two colours; beyond 1 it shines
  Vec3 light;
  float bound = 0;  // radius of the sphere about `centre` that holds it
  bool casts_shadow = true;
};

// What lies at y = 0, by the distance from a centre line x = centre_line(z).
enum class Ground : std::uint8_t { kStreet, kPath, kFloor };

// Everything visible at one instant. Coordinates are local: `origin_z` is where their z = 0 lies on
// the endless way, so that a drive of days keeps its precision.
struct Snapshot {
  static constexpr std::size_t kMaxPrimitives = 640;
  static constexpr int kLineBegin = -64;  // z of centre_line[0], metres
  static constexpr int kLineCount = 256;

  std::array<Primitive, kMaxPrimitives> storage;
  std::size_t count = 0;

  // Camera to world: columns are the camera's right, down and forward.
  std::array<Vec3, 3> axes;
  Vec3 eye;
  double origin_z = 0;

  int photographs = 0;  // of textures.h, that paint may be taken from
  Ground ground = Ground::kStreet;
  Texture floor = Texture::kPlanks;
  Vec3 ground_dark;
  Vec3 ground_light;
  std::array<float, kLineCount> centre_line{};  // x at every metre of z

  bool indoor = false;
  Vec3 room;         // indoors: half width (x), height (y), half depth (z); centred at the origin
  Vec3 sun;          // outdoors: direction towards it; indoors: where the lamp hangs
  Vec3 sun_colour;   // irradiance of a surface that faces it
  Vec3 sky_colour;   // light from above
  Vec3 haze_colour;  // of the horizon and of what is far
  float haze = 0;    // 1 / metre

  std::span<const Primitive> primitives() const { return {storage.data(), count}; }
  // Beyond kMaxPrimitives the farthest-placed are simply not there.
  void add(const Primitive& primitive) {
    if (count < storage.size()) storage[count++] = primitive;
  }
};

// Deterministic by its seed, endless in time, without any state that changes: any number of
// threads may ask at once. The seed's remainder by 3 says what it is: 0 a street, 1 a room, 2 a
// park.
class Scene {
 public:
  explicit Scene(std::uint64_t seed);

  // The world `seconds` (at least 0) after its beginning. No heap.
  void at(double seconds, Snapshot& out) const;
  bool indoor() const { return kind_ == Kind::kRoom; }
  const char* kind_name() const;

 private:
  enum class Kind : std::uint8_t { kStreet, kPark, kRoom };

  std::uint64_t seed_;
  Kind kind_;
};

}  // namespace lcdm::scene
