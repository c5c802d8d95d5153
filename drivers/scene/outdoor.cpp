// Streets and parks: endless ways. What stands beside one is decided cell by cell from the seed and
// the cell's number; what moves along one walks in streams of evenly spaced slots. So nothing ever
// ends or jumps, and any moment can be asked for.
#include <cmath>

#include "drivers/scene/parts.h"
#include "drivers/scene/places.h"

namespace lcdm::scene {
namespace {

constexpr double kTwoPi = 6.283185307179586;
constexpr int kCell = 16;          // metres of way per cell
constexpr int kOriginStep = 64;    // local coordinates move on by so much; ground textures repeat
constexpr double kSeeAhead = 108;  // metres; haze hides what appears there
constexpr double kSeeBehind = 20;  // for shadows that fall forward

// Numbers that keep the streams of chance of one seed apart.
enum Salt : std::uint64_t { kMood = 1, kCourse, kCells, kWalkers, kCars };

// The way's centre line, x = course(z), in metres along the endless way.
class Course {
 public:
  Course(std::uint64_t seed, float swing) {
    Random random(seed, kCourse, 0);
    for (Wave& wave : waves_) wave.phase = random.between(0, 6.28F);
    waves_[0].size = swing;
    waves_[0].length = random.between(150, 190);
    waves_[1].size = swing * 0.25F;
    waves_[1].length = random.between(60, 75);
  }

  float x(double z) const {
    double sum = 0;
    for (const Wave& wave : waves_) sum += wave.size * std::sin(angle(wave, z));
    return static_cast<float>(sum);
  }
  // The way's direction there, as a yaw.
  float yaw(double z) const {
    double slope = 0;
    for (const Wave& wave : waves_) {
      slope += wave.size * kTwoPi / wave.length * std::cos(angle(wave, z));
    }
    return static_cast<float>(std::atan(slope));
  }

 private:
  struct Wave {
    float size = 0;
    float length = 1;
    float phase = 0;
  };
  static double angle(const Wave& wave, double z) { return kTwoPi * z / wave.length + wave.phase; }

  Wave waves_[2];
};

// A view along a course: turns places along the way into local coordinates.
struct Way {
  const Course& course;
  double origin;  // local z = 0
  double eye;     // the camera's place along the way

  // `aside` metres to the right of the centre line, turned by `yaw` against the way's direction.
  Place place(double along, float aside, float yaw = 0) const {
    const float heading = course.yaw(along);
    return {course.x(along) + aside * std::cos(heading),
            static_cast<float>(along - origin) - aside * std::sin(heading), heading + yaw};
  }
};

void set_mood(std::uint64_t seed, Snapshot& out) {
  Random random(seed, kMood, 0);
  const float warmth = random.unit();
  const float azimuth = random.between(-1.1F, 1.1F);
  const float height = random.between(0.45F, 1.0F);
  out.indoor = false;
  out.sun = normalized({std::sin(azimuth), -height, -0.35F * std::cos(azimuth)});
  out.sun_colour = mix({0.72F, 0.7F, 0.66F}, {0.86F, 0.68F, 0.47F}, warmth);
  out.sky_colour = mix({0.42F, 0.47F, 0.56F}, {0.42F, 0.42F, 0.5F}, warmth);
  out.haze_colour = mix({0.74F, 0.81F, 0.9F}, {0.9F, 0.82F, 0.74F}, warmth);
  out.haze = 1 / random.between(62, 75);
}

void set_way(const Way& way, Snapshot& out) {
  out.origin_z = way.origin;
  for (int i = 0; i < Snapshot::kLineCount; ++i) {
    out.centre_line[static_cast<std::size_t>(i)] =
        way.course.x(way.origin + Snapshot::kLineBegin + i);
  }
}

// Calls visit(number, place along the way) for each slot of a stream within sight: slots lie
// `spacing` apart and move at `speed`.
template <typename Visit>
void for_each_slot(const Way& way, double spacing, double shift, Visit visit) {
  const auto first = static_cast<std::int64_t>(std::ceil((way.eye - kSeeBehind - shift) / spacing));
  const auto last = static_cast<std::int64_t>(std::floor((way.eye + kSeeAhead - shift) / spacing));
  for (std::int64_t i = first; i <= last; ++i) {
    visit(i, static_cast<double>(i) * spacing + shift);
  }
}

void add_walkers(std::uint64_t seed, double seconds, const Way& way, float aside, float speed,
                 double spacing, Snapshot& out) {
  const double shift = speed * seconds;
  const std::uint64_t stream = kWalkers + (aside > 0 ? 100U : 200U);
  for_each_slot(way, spacing, shift, [&](std::int64_t number, double along) {
    Random random(seed, stream, number);
    const double at = along + random.between(-0.35F, 0.35F) * static_cast<float>(spacing);
    if (random.chance(0.3F)) return;
    const float to_side = aside + random.between(-0.5F, 0.5F);
    const float yaw = speed < 0 ? 3.14159F : 0;
    const double steps = std::abs(speed) * seconds * 4.2 + random.between(0, 6.28F);
    add_person(out, random, way.place(at, to_side, yaw),
               static_cast<float>(std::fmod(steps, kTwoPi)), 1);
  });
}

// ---- the street ---------------------------------------------------------------------------------

void add_street_side(Random& random, const Way& way, double begin, float side, Snapshot& out) {
  const double middle = begin + kCell / 2.0;
  if (random.chance(0.84F)) {
    // Whole windows: the facade repeats every 3 m.
    const Vec3 half{1.5F * static_cast<float>(2 + random.below(2)),
                    1.5F * static_cast<float>(1 + random.below(4)),
                    1.5F * static_cast<float>(3 + random.below(3))};
    const float front = random.between(9.2F, 10.5F);
    add_house(out, random, way.place(middle, side * (front + half.x)), half);
  } else {
    add_fence(out, way.place(begin + 1, side * 9.0F), kCell - 3,
              paint(Texture::kPlanks, {0.86F, 0.84F, 0.8F}, 0.8F));
    add_tree(out, random, way.place(middle + random.between(-4, 4), side * 13), 1.6F);
    add_bush(out, random, way.place(middle + random.between(-5, 5), side * 10.5F));
  }
  if (random.chance(0.5F)) {
    add_tree(out, random, way.place(begin + random.between(1, 7), side * 6.2F),
             random.between(0.95F, 1.35F));
  }
  if (random.chance(0.55F)) {
    const bool parallel = side > 0;
    add_car(out, random,
            way.place(begin + random.between(3, 12), side * 4.25F, parallel ? 0 : 3.14159F));
  }
  if (random.chance(0.25F)) add_sign(out, random, way.place(begin + 9.5, side * 5.8F));
  if (random.chance(0.2F)) {
    add_bench(out, way.place(begin + 11, side * 8.2F, side > 0 ? -1.5708F : 1.5708F));
  }
}

void add_oncoming_cars(std::uint64_t seed, double seconds, const Way& way, Snapshot& out) {
  constexpr float kSpeed = -8;
  for_each_slot(way, 42, kSpeed * seconds, [&](std::int64_t number, double along) {
    Random random(seed, kCars, number);
    if (random.chance(0.35F)) return;
    add_car(out, random, way.place(along + random.between(-10, 10), -1.7F, 3.14159F));
  });
}

// The camera's progress: never backwards, now a little faster, now slower.
double travelled(double seconds, double speed) {
  return speed * (seconds + 0.9 * std::sin(0.3 * seconds));
}

Way look_along(const Course& course, double along) {
  return {course, std::floor(along / kOriginStep) * kOriginStep, along};
}

}  // namespace

void fill_street(std::uint64_t seed, double seconds, Snapshot& out) {
  const Course course(seed, 5);
  const Way way = look_along(course, travelled(seconds, 6));
  set_mood(seed, out);
  set_way(way, out);
  out.ground = Ground::kStreet;
  out.ground_dark = {0.24F, 0.36F, 0.14F};
  out.ground_light = {0.5F, 0.58F, 0.27F};

  const auto sway = static_cast<float>(std::sin(0.23 * seconds));
  const auto glance = static_cast<float>(std::sin(0.17 * seconds));
  const Place eye = way.place(way.eye, 1.6F + 0.35F * sway);
  set_camera({eye.x, -1.55F, eye.z}, eye.yaw + 0.14F * glance,
             0.05F + 0.015F * static_cast<float>(std::sin(0.9 * seconds)), 0.012F * sway, out);

  for_each_slot(way, kCell, 0, [&](std::int64_t cell, double begin) {
    Random random(seed, kCells, cell);
    add_street_side(random, way, begin, -1, out);
    add_street_side(random, way, begin, 1, out);
    if (cell % 2 == 0) {
      add_lamp_post(out, way.place(begin + 0.5, 5.7F, 3.14159F));
      add_lamp_post(out, way.place(begin + 8.5, -5.7F));
    }
  });
  add_oncoming_cars(seed, seconds, way, out);
  add_walkers(seed, seconds, way, 7.2F, -1.2F, 17, out);
  add_walkers(seed, seconds, way, -7.0F, 1.3F, 21, out);
}

// ---- the park -----------------------------------------------------------------------------------

namespace {

void add_park_side(Random& random, const Way& way, double begin, float side, Snapshot& out) {
  for (int i = 0; i < 2; ++i) {
    const Place place =
        way.place(begin + random.between(0, kCell),
                  side * random.between(i == 0 ? 4.8F : 10.0F, i == 0 ? 8.0F : 18.0F));
    if (random.chance(0.3F)) {
      add_pine(out, random, place, random.between(1.5F, 2.4F));
    } else {
      add_tree(out, random, place, random.between(1.1F, 1.9F));
    }
  }
  if (random.chance(0.6F)) {
    add_bush(out, random, way.place(begin + random.between(0, kCell), side * random.between(4, 7)));
  }
  if (random.chance(0.45F)) {
    const float radius = random.between(0.3F, 0.7F);
    const Place rock = way.place(begin + random.between(0, kCell), side * random.between(3.8F, 6));
    out.add(sphere(rock.at(0, radius * 0.35F, 0), radius,
                   paint(Texture::kConcrete, {0.6F, 0.58F, 0.55F}, 0.6F, 1.2F)));
  }
  if (random.chance(0.3F)) {
    add_bench(out,
              way.place(begin + random.between(2, 14), side * 3.9F, side > 0 ? -1.5708F : 1.5708F));
  }
}

}  // namespace

void fill_park(std::uint64_t seed, double seconds, Snapshot& out) {
  const Course course(seed, 7);
  const Way way = look_along(course, travelled(seconds, 2.6));
  set_mood(seed, out);
  set_way(way, out);
  out.ground = Ground::kPath;
  out.ground_dark = {0.22F, 0.36F, 0.13F};
  out.ground_light = {0.52F, 0.62F, 0.27F};

  const auto sway = static_cast<float>(std::sin(0.31 * seconds));
  const auto glance = static_cast<float>(std::sin(0.19 * seconds));
  const auto bob = static_cast<float>(std::sin(1.1 * seconds));
  const Place eye = way.place(way.eye, 0.5F * sway);
  set_camera({eye.x, -1.75F - 0.1F * bob, eye.z}, eye.yaw + 0.2F * glance, 0.04F + 0.02F * bob,
             0.025F * sway, out);

  for_each_slot(way, kCell, 0, [&](std::int64_t cell, double begin) {
    Random random(seed, kCells, cell);
    add_park_side(random, way, begin, -1, out);
    add_park_side(random, way, begin, 1, out);
    if (random.chance(0.6F)) {
      add_gate(out, random,
               way.place(begin + 8, random.between(-0.3F, 0.3F), random.between(-0.3F, 0.3F)),
               1.5F);
    }
    if (random.chance(0.5F)) {
      add_fence(out, way.place(begin, random.chance(0.5F) ? 3.5F : -3.5F), 9,
                paint(Texture::kPlanks, {0.6F, 0.44F, 0.3F}, 0.6F));
    }
    if (cell % 2 == 0) add_lamp_post(out, way.place(begin + 1, 3.6F, 3.14159F));
  });
  add_walkers(seed, seconds, way, 2.7F, -1.1F, 19, out);
  add_walkers(seed, seconds, way, -2.6F, 1.25F, 24, out);
}

}  // namespace lcdm::scene
