#include "drivers/scene/render.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "drivers/scene/shade.h"
#include "drivers/scene/trace.h"
#include "firmware/base/check.h"

namespace lcdm::scene {
namespace {

constexpr int kTile = 16;            // pixels; traced with a margin of one on each side
constexpr std::size_t kSamples = 4;  // rays of a pixel on an edge
constexpr float kGroundLimit = 400;  // metres; beyond is sky
constexpr float kNear = 0.05F;       // metres; nothing nearer is looked for on the screen

// Rays of a tile: its pixels row by row, then the margin: left, right, top, bottom. So shading can
// stop before the margin.
constexpr int kPixels = kTile * kTile;
constexpr int kRays = kPixels + 4 * kTile;
static_assert(kRays <= RayBatch::kCapacity);
int ray_index(int column, int row) {
  if (column < 0) return kPixels + row;
  if (column >= kTile) return kPixels + kTile + row;
  if (row < 0) return kPixels + 2 * kTile + column;
  if (row >= kTile) return kPixels + 3 * kTile + column;
  return row * kTile + column;
}

// Pixels, inclusive; empty when right < left.
struct Rectangle {
  float left = 1;
  float top = 1;
  float right = 0;
  float bottom = 0;
};

// A picture in the making: everything the tiles share.
class Picture {
 public:
  Picture(const Snapshot& snapshot, const CameraModel& camera, std::span<std::uint8_t> rgb,
          std::span<float> depth)
      : snapshot_(snapshot),
        camera_(camera),
        rgb_(rgb),
        depth_(depth),
        casters_(snapshot),
        shader_(snapshot, casters_, 1 / camera.fx) {
    for (std::size_t i = 0; i < snapshot.count; ++i) outlines_[i] = outline(snapshot.storage[i]);
    rays_.ox.fill(snapshot.eye.x);
    rays_.oy.fill(snapshot.eye.y);
    rays_.oz.fill(snapshot.eye.z);
  }

  void render() {
    for (int y = 0; y < camera_.height; y += kTile) {
      choose_for_row(y);
      for (int x = 0; x < camera_.width; x += kTile) render_tile(x, y);
    }
  }

 private:
  Vec3 ray(float x, float y) const {
    const float right = (x - camera_.cx) / camera_.fx;
    const float down = (y - camera_.cy) / camera_.fy;
    // One metre along the optical axis: so t is the depth.
    return snapshot_.axes[0] * right + snapshot_.axes[1] * down + snapshot_.axes[2];
  }
  Vec3 into_camera(Vec3 world) const {
    const Vec3 v = world - snapshot_.eye;
    return {dot(v, snapshot_.axes[0]), dot(v, snapshot_.axes[1]), dot(v, snapshot_.axes[2])};
  }

  void include(Vec3 at, Rectangle& out) const;
  Rectangle outline(const Primitive& primitive) const;
  Rectangle outline_box(const Primitive& primitive) const;
  Rectangle outline_ball(Vec3 centre, float radius) const;
  void choose_for_row(int y);
  std::span<const std::uint16_t> choose(int x);
  void aim_at_tile(int x, int y);
  void trace_rays(std::span<const std::uint16_t> chosen);
  void render_tile(int x, int y);
  int find_edges(int width, int height);
  void smooth_edges(int x, int y, std::span<const std::uint16_t> chosen, int edges);
  void trace_samples(int x, int y, std::span<const std::uint16_t> pixels,
                     std::span<const std::uint16_t> chosen);
  void shade_samples();
  void put(int x, int y, Vec3 colour);

  const Snapshot& snapshot_;
  const CameraModel& camera_;
  std::span<std::uint8_t> rgb_;
  std::span<float> depth_;
  ShadowCasters casters_;
  Shader shader_;
  std::array<Rectangle, Snapshot::kMaxPrimitives> outlines_;
  std::array<std::uint16_t, Snapshot::kMaxPrimitives> in_row_;
  std::size_t in_row_count_ = 0;
  std::array<std::uint16_t, Snapshot::kMaxPrimitives> chosen_;
  RayBatch rays_;
  std::array<Vec3, RayBatch::kCapacity> colours_;
  std::array<std::uint16_t, RayBatch::kCapacity> shaded_as_;
  std::array<std::uint16_t, kPixels> edges_;  // of this tile, as ray indices
};

// Widens the rectangle by a point at or beyond the near plane.
void Picture::include(Vec3 at, Rectangle& out) const {
  const float inverse = 1 / std::max(kNear, at.z);
  const float x = at.x * inverse * camera_.fx + camera_.cx;
  const float y = at.y * inverse * camera_.fy + camera_.cy;
  if (out.right < out.left) {
    out = {x, y, x, y};
    return;
  }
  out = {std::min(out.left, x), std::min(out.top, y), std::max(out.right, x),
         std::max(out.bottom, y)};
}

Rectangle Picture::outline(const Primitive& p) const {
  if (p.shape == Shape::kBox) return outline_box(p);
  if (p.shape != Shape::kCapsule) return outline_ball(p.centre, p.bound);
  const Rectangle a = outline_ball(p.centre - p.half, p.radius);
  const Rectangle b = outline_ball(p.centre + p.half, p.radius);
  // An end behind the eye says nothing about where the other goes on the screen.
  if (a.right < a.left && b.right < b.left) return {};
  if (a.right < a.left || b.right < b.left) return outline_ball(p.centre, p.bound);
  return {std::min(a.left, b.left), std::min(a.top, b.top), std::max(a.right, b.right),
          std::max(a.bottom, b.bottom)};
}

Rectangle Picture::outline_ball(Vec3 centre, float radius) const {
  const Vec3 c = into_camera(centre);
  if (c.z + radius < kNear) return {};
  const auto side = [](int pixels) { return static_cast<float>(pixels); };
  if (c.z - radius < kNear) return {0, 0, side(camera_.width), side(camera_.height)};
  Rectangle out;
  for (const float z : {c.z - radius, c.z + radius}) {
    include({c.x - radius, c.y - radius, z}, out);
    include({c.x + radius, c.y + radius, z}, out);
  }
  return out;
}

// The twelve edges, each cut at the near plane.
Rectangle Picture::outline_box(const Primitive& p) const {
  std::array<Vec3, 8> corners;
  for (std::size_t i = 0; i < 8; ++i) {
    const float x = (i & 1U) != 0 ? p.half.x : -p.half.x;
    const float y = (i & 2U) != 0 ? p.half.y : -p.half.y;
    const float z = (i & 4U) != 0 ? p.half.z : -p.half.z;
    corners[i] = into_camera(p.centre +
                             Vec3{p.cos_yaw * x + p.sin_yaw * z, y, p.cos_yaw * z - p.sin_yaw * x});
  }
  Rectangle out;
  for (std::size_t i = 0; i < 8; ++i) {
    if (corners[i].z >= kNear) include(corners[i], out);
    for (const std::size_t bit : {1U, 2U, 4U}) {
      if ((i & bit) != 0) continue;
      const Vec3 a = corners[i];
      const Vec3 b = corners[i | bit];
      if ((a.z < kNear) == (b.z < kNear)) continue;
      include(mix(a, b, (kNear - a.z) / (b.z - a.z)), out);
    }
  }
  return out;
}

// The primitives that may show in the row of tiles at y, or its margin.
void Picture::choose_for_row(int y) {
  const auto top = static_cast<float>(y - 2);
  const auto bottom = static_cast<float>(y + kTile + 1);
  in_row_count_ = 0;
  for (std::size_t i = 0; i < snapshot_.count; ++i) {
    const Rectangle& o = outlines_[i];
    if (o.right < o.left || o.bottom < top || o.top > bottom) continue;
    in_row_[in_row_count_++] = static_cast<std::uint16_t>(i);
  }
}

// Those of the row that may show in its tile at x, or that tile's margin.
std::span<const std::uint16_t> Picture::choose(int x) {
  const auto left = static_cast<float>(x - 2);
  const auto right = static_cast<float>(x + kTile + 1);
  std::size_t count = 0;
  for (const std::uint16_t i : std::span(in_row_).first(in_row_count_)) {
    const Rectangle& o = outlines_[i];
    if (o.right >= left && o.left <= right) chosen_[count++] = i;
  }
  return std::span(chosen_).first(count);
}

// Rays through the tile's pixel centres and the margin's.
void Picture::aim_at_tile(int x, int y) {
  const Vec3 step = snapshot_.axes[0] * (1 / camera_.fx);
  for (int row = 0; row < kTile; ++row) {
    const Vec3 first = ray(static_cast<float>(x), static_cast<float>(y + row));
    for (int column = 0; column < kTile; ++column) {
      const auto k = static_cast<std::size_t>(ray_index(column, row));
      const auto along = static_cast<float>(column);
      rays_.dx[k] = first.x + step.x * along;
      rays_.dy[k] = first.y + step.y * along;
      rays_.dz[k] = first.z + step.z * along;
    }
  }
  std::fill_n(rays_.t.begin(), kPixels, kFar);
  std::fill_n(rays_.hit.begin(), kPixels, kHitNothing);
  const auto aim = [&](int column, int row) {
    rays_.set(ray_index(column, row), snapshot_.eye,
              ray(static_cast<float>(x + column), static_cast<float>(y + row)), kFar);
  };
  for (int i = 0; i < kTile; ++i) {
    aim(-1, i);
    aim(kTile, i);
    aim(i, -1);
    aim(i, kTile);
  }
  rays_.count = kRays;
}

void Picture::trace_rays(std::span<const std::uint16_t> chosen) {
  trace_ground(kGroundLimit, rays_);
  trace(snapshot_.primitives(), chosen, rays_);
}

void Picture::render_tile(int x, int y) {
  const int width = std::min(kTile, camera_.width - x);
  const int height = std::min(kTile, camera_.height - y);
  const auto chosen = choose(x);
  aim_at_tile(x, y);
  trace_rays(chosen);
  const int edges = find_edges(width, height);

  rays_.count = kPixels;
  shader_.shade(rays_, colours_);
  for (int row = 0; row < height; ++row) {
    for (int column = 0; column < width; ++column) {
      const auto k = static_cast<std::size_t>(ray_index(column, row));
      put(x + column, y + row, colours_[k]);
      if (depth_.empty()) continue;
      const std::ptrdiff_t pixel =
          static_cast<std::ptrdiff_t>(y + row) * camera_.width + x + column;
      depth_[static_cast<std::size_t>(pixel)] = rays_.hit[k] == kHitNothing ? 0 : rays_.t[k];
    }
  }
  smooth_edges(x, y, chosen, edges);
}

// Lists the pixels beside which something else begins.
int Picture::find_edges(int width, int height) {
  const auto hits = std::span(rays_.hit).first(kRays);
  const auto other = [first = hits[0]](std::int32_t hit) { return hit != first; };
  if (std::none_of(hits.begin(), hits.end(), other)) return 0;

  // With the margin around it every pixel has four neighbours at fixed steps.
  constexpr std::size_t kWide = kTile + 2;
  std::array<std::int32_t, kWide * kWide> grid;
  const auto at = [](int column, int row) {
    return static_cast<std::size_t>(row + 1) * kWide + static_cast<std::size_t>(column + 1);
  };
  const auto copy = [&](int column, int row) {
    grid[at(column, row)] = hits[static_cast<std::size_t>(ray_index(column, row))];
  };
  for (int i = 0; i < kTile; ++i) {
    for (int column = 0; column < kTile; ++column) copy(column, i);
    copy(-1, i);
    copy(kTile, i);
    copy(i, -1);
    copy(i, kTile);
  }
  std::size_t count = 0;
  for (int row = 0; row < height; ++row) {
    for (int column = 0; column < width; ++column) {
      const std::size_t k = at(column, row);
      const std::int32_t here = grid[k];
      const int same = (grid[k - 1] == here ? 1 : 0) & (grid[k + 1] == here ? 1 : 0) &
                       (grid[k - kWide] == here ? 1 : 0) & (grid[k + kWide] == here ? 1 : 0);
      if (same == 0) edges_[count++] = static_cast<std::uint16_t>(ray_index(column, row));
    }
  }
  return static_cast<int>(count);
}

// Colours each listed pixel anew, from rays through a rotated grid. Each thing that shows in a
// pixel is shaded once, as multi-sampling does: only visibility is asked for at every sample.
void Picture::smooth_edges(int x, int y, std::span<const std::uint16_t> chosen, int edges) {
  constexpr int kAtOnce = RayBatch::kCapacity / static_cast<int>(kSamples);
  for (int begin = 0; begin < edges; begin += kAtOnce) {
    const auto pixels =
        std::span(edges_).subspan(static_cast<std::size_t>(begin),
                                  static_cast<std::size_t>(std::min(kAtOnce, edges - begin)));
    trace_samples(x, y, pixels, chosen);
    shade_samples();
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      Vec3 sum;
      for (std::size_t s = 0; s < kSamples; ++s) {
        const Vec3 c = colours_[shaded_as_[i * kSamples + s]];
        sum = sum + Vec3{std::min(c.x, 1.0F), std::min(c.y, 1.0F), std::min(c.z, 1.0F)};
      }
      const int column = pixels[i] % kTile;
      const int row = pixels[i] / kTile;
      put(x + column, y + row, sum * (1.0F / kSamples));
    }
  }
}

void Picture::trace_samples(int x, int y, std::span<const std::uint16_t> pixels,
                            std::span<const std::uint16_t> chosen) {
  static constexpr std::array<std::array<float, 2>, kSamples> kOffsets{
      {{-0.125F, -0.375F}, {0.375F, -0.125F}, {-0.375F, 0.125F}, {0.125F, 0.375F}}};
  int i = 0;
  for (const std::uint16_t pixel : pixels) {
    const int column = x + pixel % kTile;
    const int row = y + pixel / kTile;
    for (const auto& offset : kOffsets) {
      rays_.set(i++, snapshot_.eye,
                ray(static_cast<float>(column) + offset[0], static_cast<float>(row) + offset[1]),
                kFar);
    }
  }
  rays_.count = i;
  trace_rays(chosen);
}

// Moves the first sample of each thing in each pixel to the front of the batch and shades those;
// shaded_as_ says for every sample which of them stands for it.
void Picture::shade_samples() {
  const auto samples = static_cast<std::size_t>(rays_.count);
  std::size_t kept = 0;
  for (std::size_t first = 0; first < samples; first += kSamples) {
    const std::size_t kept_before = kept;
    for (std::size_t i = first; i < first + kSamples; ++i) {
      std::size_t same = kept_before;
      while (same < kept && rays_.hit[same] != rays_.hit[i]) ++same;
      shaded_as_[i] = static_cast<std::uint16_t>(same);
      if (same == kept) rays_.copy(i, kept++);
    }
  }
  rays_.count = static_cast<int>(kept);
  shader_.shade(rays_, colours_);
}

void Picture::put(int x, int y, Vec3 colour) {
  std::uint8_t* out = rgb_.data() + (static_cast<std::ptrdiff_t>(y) * camera_.width + x) * 3;
  const auto byte = [](float v) {
    // Rounded to nearest, as the value is not negative.
    return static_cast<std::uint8_t>(std::clamp(v, 0.0F, 1.0F) * 255.0F + 0.5F);  // NOLINT
  };
  out[0] = byte(colour.x);
  out[1] = byte(colour.y);
  out[2] = byte(colour.z);
}

}  // namespace

void render(const Snapshot& snapshot, const CameraModel& camera, std::span<std::uint8_t> rgb,
            std::span<float> depth) {
  const auto pixels =
      static_cast<std::size_t>(camera.width) * static_cast<std::size_t>(camera.height);
  LCDM_CHECK(rgb.size() == 3 * pixels);
  LCDM_CHECK(depth.empty() || depth.size() == pixels);
  Picture(snapshot, camera, rgb, depth).render();
}

void render(const Scene& scene, double seconds, const CameraModel& camera,
            std::span<std::uint8_t> rgb, std::span<float> depth) {
  Snapshot snapshot;
  scene.at(seconds, snapshot);
  render(snapshot, camera, rgb, depth);
}

}  // namespace lcdm::scene
