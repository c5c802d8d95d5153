// Vectors and seeded numbers of the rendered scene: plain, so that the ray loops stay cheap.
#pragma once

#include <cmath>
#include <cstdint>

namespace lcdm::scene {

constexpr float kPi = 3.14159265F;

// x right, y down, z forward (REP 103 optical frame). Metres, a direction, or red-green-blue.
struct Vec3 {
  float x = 0;
  float y = 0;
  float z = 0;
};

inline Vec3 operator+(Vec3 a, Vec3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec3 operator-(Vec3 a, Vec3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vec3 operator*(Vec3 a, float s) { return {a.x * s, a.y * s, a.z * s}; }
inline Vec3 operator*(Vec3 a, Vec3 b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }
inline float dot(Vec3 a, Vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec3 cross(Vec3 a, Vec3 b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
inline float length(Vec3 a) { return std::sqrt(dot(a, a)); }
inline Vec3 normalized(Vec3 a) { return a * (1 / length(a)); }
inline Vec3 mix(Vec3 a, Vec3 b, float t) { return a + (b - a) * t; }

// The same numbers on every machine for the same seed (splitmix64; the standard library's
// distributions promise no such thing).
class Random {
 public:
  explicit Random(std::uint64_t seed) : state_(seed) {}
  // An independent stream for item `index` of collection `salt`.
  Random(std::uint64_t seed, std::uint64_t salt, std::int64_t index)
      : state_(mixed(seed ^ mixed(salt ^ mixed(static_cast<std::uint64_t>(index))))) {}

  std::uint64_t next() { return mixed(state_ += 0x9E3779B97F4A7C15U); }
  // In [0, 1).
  float unit() { return static_cast<float>(next() >> 40) * (1.0F / 16777216.0F); }
  float between(float low, float high) { return low + (high - low) * unit(); }
  int below(int count) { return static_cast<int>(next() % static_cast<std::uint64_t>(count)); }
  bool chance(float probability) { return unit() < probability; }

 private:
  static std::uint64_t mixed(std::uint64_t x) {
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9U;
    x = (x ^ (x >> 27)) * 0x94D049BB133111EBU;
    return x ^ (x >> 31);
  }

  std::uint64_t state_;
};

}  // namespace lcdm::scene
