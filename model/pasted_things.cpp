#include "model/pasted_things.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "drivers/scene/places.h"
#include "drivers/scene/render.h"
#include "drivers/scene/textures.h"

namespace lcdm::model {
namespace {

using scene::Vec3;

constexpr std::uint64_t kPlaneSalt = 21;
constexpr std::uint64_t kThingsSalt = 22;

// ---- where is something level -------------------------------------------------------------------

constexpr int kPoints = 600;          // looked at in a picture
constexpr int kTriples = 80;          // planes tried
constexpr float kThickness = 0.015F;  // of a point's distance: what still counts as on the plane
constexpr float kLeastShare = 0.1F;   // of the points
constexpr float kLeastUp = 0.64F;     // cosine of 50 degrees
constexpr float kLowestEye = 0.25F;   // metres above the plane
constexpr float kHighestEye = 3;

// Where a pixel of known depth lies, camera axes, metres.
Vec3 point_at(const PackFrame& frame, int x, int y) {
  const float depth = frame.depth.at<float>(y, x);
  const CameraModel& camera = frame.camera;
  return Vec3{(static_cast<float>(x) - camera.cx) / camera.fx,
              (static_cast<float>(y) - camera.cy) / camera.fy, 1} *
         depth;
}

std::vector<Vec3> random_points(const PackFrame& frame, scene::Random& random) {
  std::vector<Vec3> points;
  points.reserve(kPoints);
  for (int i = 0; i < kPoints; ++i) {
    const int x = random.below(frame.depth.cols);
    const int y = random.below(frame.depth.rows);
    if (frame.depth.at<float>(y, x) > 0) points.push_back(point_at(frame, x, y));
  }
  return points;
}

bool lies_on(const LevelPlane& plane, Vec3 point) {
  return std::abs(dot(plane.up, point) + plane.height) < kThickness * length(point);
}

// The plane through three points; nothing where it is no level one below the camera.
std::optional<LevelPlane> plane_through(Vec3 a, Vec3 b, Vec3 c) {
  const Vec3 normal = cross(b - a, c - a);
  const float size = length(normal);
  if (!(size > 1e-6F)) return std::nullopt;
  const float sign = normal.y > 0 ? -1.0F : 1.0F;
  const LevelPlane plane{normal * (sign / size), -dot(normal, a) * (sign / size)};
  const bool level = -plane.up.y > kLeastUp;
  if (!level || plane.height < kLowestEye || plane.height > kHighestEye) return std::nullopt;
  return plane;
}

// ---- the things there ---------------------------------------------------------------------------

// A world whose y = 0 is the plane, seen from the camera's place: an even grey floor under a lamp.
std::unique_ptr<scene::Snapshot> world_on(const LevelPlane& plane, const PackFrame& frame,
                                          scene::Random& random) {
  auto world = std::make_unique<scene::Snapshot>();
  const Vec3 down = plane.up * -1;
  const Vec3 ahead = normalized(Vec3{0, 0, 1} - down * down.z);
  const Vec3 right = cross(down, ahead);
  world->axes = {Vec3{right.x, down.x, ahead.x}, Vec3{right.y, down.y, ahead.y},
                 Vec3{right.z, down.z, ahead.z}};
  world->eye = {0, -plane.height, 0};
  world->indoor = true;
  world->ground = scene::Ground::kFloor;
  world->floor = scene::Texture::kPlain;
  world->ground_dark = world->ground_light = {0.5F, 0.5F, 0.5F};
  world->sun = {random.between(-2, 2), -plane.height - random.between(0.3F, 1.5F),
                random.between(-1, 3)};
  // About as bright as the picture.
  const cv::Scalar mean = cv::mean(frame.rgb) / (3 * 255 * 0.45);
  const float bright = std::clamp(static_cast<float>(mean[0] + mean[1] + mean[2]), 0.3F, 1.5F) *
                       random.between(1, 1.8F);
  const float lamp = random.between(0.3F, 1);
  world->sun_colour = Vec3{0.95F, 0.92F, 0.85F} * (lamp * bright);
  world->sky_colour = Vec3{0.8F, 0.8F, 0.8F} * ((1 - lamp / 2) * bright);
  return world;
}

// On points that lie on the plane, none around the camera.
void add_things(const LevelPlane& plane, const PackFrame& frame, scene::Random& random,
                scene::Snapshot& world) {
  constexpr float kAir = 0.5F;      // metres around the camera, as sensors of depth need
  constexpr float kTallest = 2.3F;  // metres
  std::vector<Vec3> feet;
  for (const Vec3 point : random_points(frame, random)) {
    if (lies_on(plane, point)) feet.push_back(point);
  }
  const int count = feet.empty() ? 0 : 1 + random.below(4);
  for (int i = 0; i < count; ++i) {
    const Vec3 foot = feet[static_cast<std::size_t>(random.below(static_cast<int>(feet.size())))];
    const Vec3 at =
        world.eye + world.axes[0] * foot.x + world.axes[1] * foot.y + world.axes[2] * foot.z;
    const std::size_t before = world.count;
    scene::add_indoor_thing(random, {at.x, at.z, random.between(-scene::kPi, scene::kPi)}, kTallest,
                            world);
    if (!scene::is_free(world, world.eye, kAir)) world.count = before;
  }
}

// ---- into the picture ---------------------------------------------------------------------------

struct Rendered {
  cv::Mat rgb;    // CV_8UC3
  cv::Mat depth;  // CV_32F
};
Rendered rendered(const scene::Snapshot& world, const CameraModel& camera) {
  Rendered out{cv::Mat(camera.height, camera.width, CV_8UC3),
               cv::Mat(camera.height, camera.width, CV_32F)};
  scene::render(world, camera, {out.rgb.ptr<std::uint8_t>(), out.rgb.total() * 3},
                {out.depth.ptr<float>(), out.depth.total()});
  return out;
}

// Every unknown depth as that of the nearest pixel that has one.
cv::Mat without_holes(const cv::Mat& depth) {
  cv::Mat distance;
  cv::Mat labels;
  cv::distanceTransform(depth <= 0, distance, labels, cv::DIST_L2, cv::DIST_MASK_5,
                        cv::DIST_LABEL_PIXEL);
  std::vector<float> of_label(depth.total() + 1, 0);
  const auto each = [&](auto&& visit) {
    for (int y = 0; y < depth.rows; ++y) {
      for (int x = 0; x < depth.cols; ++x) visit(y, x);
    }
  };
  each([&](int y, int x) {
    const float known = depth.at<float>(y, x);
    if (known > 0) of_label[static_cast<std::size_t>(labels.at<int>(y, x))] = known;
  });
  cv::Mat full(depth.size(), CV_32F);
  each([&](int y, int x) {
    full.at<float>(y, x) = of_label[static_cast<std::size_t>(labels.at<int>(y, x))];
  });
  return full;
}

// Darkens what lies on the plane where the things keep the lamp's light off it.
void cast_shadows(const Rendered& with, const Rendered& bare, const cv::Mat& surface,
                  cv::Mat& rgb) {
  const cv::Mat on_plane = (cv::abs(surface - bare.depth) < 0.05 * bare.depth) &
                           (with.depth == bare.depth) & (bare.depth > 0);
  cv::Mat shaded;
  cv::Mat lit;
  with.rgb.convertTo(shaded, CV_32FC3);
  bare.rgb.convertTo(lit, CV_32FC3);
  cv::Mat share;
  cv::divide(shaded, cv::max(lit, 1.0), share);
  cv::Mat dark;
  rgb.convertTo(dark, CV_32FC3);
  dark = dark.mul(cv::min(share, 1.0));
  dark.convertTo(dark, CV_8UC3);
  dark.copyTo(rgb, on_plane);
}

// `things` over `rgb` where `visible`, as soft at its border as a lens is.
void lay_over(const cv::Mat& things, const cv::Mat& visible, double softness, cv::Mat& rgb) {
  cv::Mat cover;
  visible.convertTo(cover, CV_32F, 1.0 / 255);
  cv::GaussianBlur(cover, cover, {}, softness);
  cv::Mat soft;
  cv::GaussianBlur(things, soft, {}, softness);
  cv::Mat bare;
  cv::Mat front;
  rgb.convertTo(bare, CV_32FC3);
  soft.convertTo(front, CV_32FC3);
  cv::Mat cover3;
  cv::cvtColor(cover, cover3, cv::COLOR_GRAY2BGR);
  cv::Mat mixed = bare + (front - bare).mul(cover3);
  mixed.convertTo(rgb, CV_8UC3);
}

}  // namespace

std::optional<LevelPlane> find_level_plane(const PackFrame& frame, std::uint64_t seed) {
  scene::Random random(seed, kPlaneSalt, 0);
  const std::vector<Vec3> points = random_points(frame, random);
  if (points.size() < 30) return std::nullopt;
  const auto any = [&] {
    return points[static_cast<std::size_t>(random.below(static_cast<int>(points.size())))];
  };
  std::optional<LevelPlane> best;
  auto most = static_cast<std::ptrdiff_t>(kLeastShare * static_cast<float>(points.size()));
  for (int i = 0; i < kTriples; ++i) {
    const Vec3 a = any();
    const Vec3 b = any();
    const auto plane = plane_through(a, b, any());
    if (!plane) continue;
    const auto on = std::count_if(points.begin(), points.end(),
                                  [&](Vec3 point) { return lies_on(*plane, point); });
    if (on <= most) continue;
    most = on;
    best = plane;
  }
  return best;
}

bool paste_things(std::uint64_t seed, PackFrame& frame) {
  constexpr double kMostHidden = 0.6;  // of the picture
  scene::textures();
  const auto plane = find_level_plane(frame, seed);
  if (!plane) return false;
  scene::Random random(seed, kThingsSalt, 0);
  const auto world = world_on(*plane, frame, random);
  const Rendered bare = rendered(*world, frame.camera);
  add_things(*plane, frame, random, *world);
  const Rendered with = rendered(*world, frame.camera);

  const cv::Mat surface = without_holes(frame.depth);
  // Depth on the floor is noisy: what stands there must not sink in.
  const cv::Mat visible =
      (with.depth > 0) & (with.depth != bare.depth) & (with.depth < 1.03 * surface);
  const double hidden = cv::countNonZero(visible) / static_cast<double>(visible.total());
  if (hidden == 0 || hidden > kMostHidden) return false;
  frame.rgb = frame.rgb.clone();  // its pixels may be shared
  frame.depth = frame.depth.clone();
  cast_shadows(with, bare, surface, frame.rgb);
  lay_over(with.rgb, visible, random.between(0.5F, 1.1F), frame.rgb);
  with.depth.copyTo(frame.depth, visible);
  return true;
}

}  // namespace lcdm::model
