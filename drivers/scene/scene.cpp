#include "drivers/scene/scene.h"

#include <algorithm>

#include "drivers/scene/places.h"

namespace lcdm::scene {

Scene::Scene(std::uint64_t seed) : seed_(seed) {
  constexpr Kind kKinds[] = {Kind::kStreet, Kind::kRoom, Kind::kPark};
  kind_ = kKinds[seed % 3];
}

void Scene::at(double seconds, Snapshot& out) const {
  out.count = 0;
  out.photographs = 0;
  const double time = std::max(0.0, seconds);
  switch (kind_) {
    case Kind::kStreet:
      return fill_street(seed_, time, out);
    case Kind::kPark:
      return fill_park(seed_, time, out);
    case Kind::kRoom:
      return fill_room(seed_, time, out);
  }
}

const char* Scene::kind_name() const {
  switch (kind_) {
    case Kind::kStreet:
      return "street";
    case Kind::kPark:
      return "park";
    case Kind::kRoom:
      return "room";
  }
  return "";
}

void set_camera(Vec3 eye, float yaw, float pitch, float roll, Snapshot& out) {
  const Vec3 forward{std::sin(yaw) * std::cos(pitch), std::sin(pitch),
                     std::cos(yaw) * std::cos(pitch)};
  const Vec3 level{std::cos(yaw), 0, -std::sin(yaw)};
  // forward x level
  const Vec3 down{forward.y * level.z - forward.z * level.y,
                  forward.z * level.x - forward.x * level.z,
                  forward.x * level.y - forward.y * level.x};
  out.eye = eye;
  out.axes[0] = level * std::cos(roll) + down * std::sin(roll);
  out.axes[1] = down * std::cos(roll) - level * std::sin(roll);
  out.axes[2] = forward;
}

}  // namespace lcdm::scene
