#include "drivers/scene/textures.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace lcdm::scene {
namespace {

struct TextureSample {
  float mix = 1;     // between the surface's dark (0) and light (1) colour
  float bright = 1;  // factor on top, about 1
};

constexpr float kTwoPi = 6.2831853F;

std::uint32_t hash(int x, int y, std::uint32_t salt) {
  std::uint32_t h = static_cast<std::uint32_t>(x) * 0x8DA6B343U ^
                    static_cast<std::uint32_t>(y) * 0xD8163841U ^ salt * 0xCB1AB31FU;
  h = (h ^ (h >> 15)) * 0x2C1B3C6DU;
  h = (h ^ (h >> 12)) * 0x297A2D39U;
  return h ^ (h >> 15);
}

float random_at(int x, int y, std::uint32_t salt) {
  return static_cast<float>(hash(x, y, salt) >> 8) * (1.0F / 16777216.0F);
}

float smooth(float t) { return t * t * (3 - 2 * t); }
float ramp(float low, float high, float x) {
  return smooth(std::clamp((x - low) / (high - low), 0.0F, 1.0F));
}
int wrapped(int i, int period) { return ((i % period) + period) % period; }

// Value noise over [0, 1)^2 with nx x ny cells, seamless; in [0, 1].
float noise(float x, float y, int nx, int ny, std::uint32_t salt) {
  const float px = x * static_cast<float>(nx);
  const float py = y * static_cast<float>(ny);
  const int ix = static_cast<int>(std::floor(px));
  const int iy = static_cast<int>(std::floor(py));
  const float fx = smooth(px - static_cast<float>(ix));
  const float fy = smooth(py - static_cast<float>(iy));
  const auto at = [&](int dx, int dy) {
    return random_at(wrapped(ix + dx, nx), wrapped(iy + dy, ny), salt);
  };
  const float top = at(0, 0) + (at(1, 0) - at(0, 0)) * fx;
  const float bottom = at(0, 1) + (at(1, 1) - at(0, 1)) * fx;
  return top + (bottom - top) * fy;
}

// Octaves of noise from nx x ny cells on, each twice as fine; in [0, 1].
float fractal(float x, float y, int nx, int ny, int octaves, std::uint32_t salt) {
  float sum = 0;
  float weight = 0;
  float amplitude = 1;
  for (int i = 0; i < octaves; ++i) {
    sum += amplitude * noise(x, y, nx << i, ny << i, salt + static_cast<std::uint32_t>(i));
    weight += amplitude;
    amplitude *= 0.62F;
  }
  return sum / weight;
}

// Distance to the nearest of one random point per cell of n x n, in cells: blobs and leaves.
float cellular(float x, float y, int n, std::uint32_t salt, float& shade) {
  const float px = x * static_cast<float>(n);
  const float py = y * static_cast<float>(n);
  const int ix = static_cast<int>(std::floor(px));
  const int iy = static_cast<int>(std::floor(py));
  float best = 9;
  for (int dy = -1; dy <= 1; ++dy) {
    for (int dx = -1; dx <= 1; ++dx) {
      const int cx = wrapped(ix + dx, n);
      const int cy = wrapped(iy + dy, n);
      const float x_to = static_cast<float>(ix + dx) + random_at(cx, cy, salt) - px;
      const float y_to = static_cast<float>(iy + dy) + random_at(cx, cy, salt + 1) - py;
      const float distance = x_to * x_to + y_to * y_to;
      if (distance < best) {
        best = distance;
        shade = random_at(cx, cy, salt + 2);
      }
    }
  }
  return std::sqrt(best);
}

// How far x lies inside the joints of `n` equal parts: 0 on a joint, 1 beyond `width` of a part.
float joint(float x, float n, float width) {
  const float part = x * n - std::floor(x * n);
  return ramp(0.3F * width, width, std::min(part, 1 - part));
}

TextureSample plaster(float x, float y) {
  return {fractal(x, y, 3, 3, 5, 11), 0.9F + 0.2F * fractal(x, y, 40, 40, 3, 12)};
}

TextureSample brick(float x, float y) {
  constexpr int kRows = 12;
  constexpr int kColumns = 4;
  const int row = static_cast<int>(y * kRows);
  const float shifted = x + (row % 2 == 0 ? 0 : 0.5F / kColumns);
  const int column = wrapped(static_cast<int>(std::floor(shifted * kColumns)), kColumns);
  const float inside = joint(y, kRows, 0.14F) * joint(shifted, kColumns, 0.05F);
  const float shade = 0.45F + 0.55F * random_at(column, row, 21);
  const float grain = fractal(x, y, 24, 24, 4, 22);
  return {inside * shade * (0.7F + 0.5F * grain), 0.85F + 0.3F * grain};
}

TextureSample planks(float x, float y) {
  constexpr int kPlanks = 8;
  const int plank = static_cast<int>(x * kPlanks);
  const float offset = random_at(plank, 0, 31);
  const float along = y + offset - std::floor(y + offset);
  const float grain = fractal(x, along, 48, 3, 3, 32);
  const float rings =
      0.5F + 0.5F * std::sin(kTwoPi * (along * 3 + 3 * fractal(x, along, 16, 2, 2, 33)));
  const float gaps = joint(x, kPlanks, 0.05F) * joint(along, 2, 0.008F);
  const float shade = 0.55F + 0.45F * random_at(plank, along < 0.5F ? 1 : 2, 34);
  return {gaps * shade * (0.55F + 0.35F * grain + 0.2F * rings), 0.88F + 0.24F * grain};
}

TextureSample weave(float x, float y) {
  const float threads =
      0.5F + 0.25F * std::sin(kTwoPi * 40 * x) + 0.25F * std::sin(kTwoPi * 40 * y);
  const float bands = ramp(0.4F, 0.6F, noise(x, y, 6, 6, 41));
  return {0.35F * threads + 0.45F * bands + 0.2F * fractal(x, y, 8, 8, 4, 42),
          0.85F + 0.3F * threads};
}

TextureSample grass(float x, float y) {
  const float blades = fractal(x, y, 48, 48, 3, 52);
  return {0.65F * fractal(x, y, 3, 3, 5, 51) + 0.35F * blades, 0.7F + 0.6F * blades};
}

TextureSample asphalt(float x, float y) {
  const float stones = noise(x, y, 110, 110, 61);
  const float patches = fractal(x, y, 2, 2, 4, 62);
  const float crack = std::abs(fractal(x, y, 5, 5, 4, 63) - 0.5F);
  return {ramp(0, 0.012F, crack) * (0.5F * patches + 0.5F * stones), 0.82F + 0.36F * stones};
}

TextureSample foliage(float x, float y) {
  float coarse_shade = 0;
  float fine_shade = 0;
  const float coarse = cellular(x, y, 7, 71, coarse_shade);
  const float fine = cellular(x, y, 22, 75, fine_shade);
  const float lit = 0.55F * coarse_shade + 0.45F * fine_shade;
  return {lit * (1.1F - 0.55F * fine) * (1.15F - 0.6F * coarse), 0.8F + 0.4F * fine_shade};
}

TextureSample bark(float x, float y) {
  const float ridges = fractal(x, y, 14, 3, 4, 81);
  return {ramp(0.25F, 0.75F, ridges), 0.8F + 0.4F * noise(x, y, 60, 30, 82)};
}

// One storey of four windows, each its own: 12 m x 3 m of wall in one tile of 12 m x 12 m.
TextureSample facade(float x, float y) {
  constexpr int kWindows = 4;
  const int column = static_cast<int>(x * kWindows);
  const int row = static_cast<int>(y * kWindows);
  const float wx = x * kWindows - static_cast<float>(column);
  const float wy = y * kWindows - static_cast<float>(row);
  const float grain = fractal(x, y, 30, 30, 3, 91);
  const auto inside = [&](float margin) {
    return wx > 0.3F - margin && wx < 0.7F + margin && wy > 0.24F - margin && wy < 0.78F + margin;
  };
  const bool bar = std::abs(wx - 0.5F) < 0.016F || std::abs(wy - 0.44F) < 0.014F;
  if (inside(0) && !bar) {
    const bool curtain = random_at(column, row, 92) < 0.35F && wy < 0.56F;
    return {curtain ? 0.55F : 0.1F * wy, 0.75F + 0.7F * (1 - wy) * random_at(column, row, 93)};
  }
  if (inside(0.035F)) return {1, 1.18F};
  if (wy > 0.815F && wy < 0.85F && wx > 0.24F && wx < 0.76F) return {0.8F, 1.1F};
  return {0.82F + 0.18F * fractal(x, y, 5, 5, 4, 94), 0.9F + 0.2F * grain};
}

TextureSample tiles(float x, float y) {
  constexpr int kTiles = 6;
  const float shade = random_at(static_cast<int>(x * kTiles), static_cast<int>(y * kTiles), 101);
  const float inside = joint(x, kTiles, 0.035F) * joint(y, kTiles, 0.035F);
  const float veins = fractal(x, y, 9, 9, 4, 102);
  return {inside * (0.45F + 0.4F * shade + 0.3F * (veins - 0.3F)), 0.9F + 0.2F * veins};
}

TextureSample concrete(float x, float y) {
  const float pits = noise(x, y, 90, 90, 112);
  return {0.75F * fractal(x, y, 3, 3, 5, 111) + 0.25F * pits, 0.84F + 0.32F * pits};
}

TextureSample books(float x, float y) {
  constexpr int kBooks = 26;
  const int book = static_cast<int>(x * kBooks);
  const float spine = joint(x, kBooks, 0.12F);
  const float title = std::abs(y - 0.15F - 0.5F * random_at(book, 1, 121)) < 0.05F ? 0.35F : 0;
  const float colour = random_at(book, 0, 122);
  return {std::clamp(colour + title, 0.0F, 1.0F), spine * (0.55F + 0.7F * random_at(book, 2, 123))};
}

TextureSample painting(float x, float y) {
  const float shape = fractal(x, y, 3, 2, 4, 131);
  const float bands = std::floor(shape * 7) / 7;
  return {ramp(0.15F, 0.8F, bands), 0.75F + 0.5F * fractal(x, y, 6, 6, 4, 132)};
}

TextureSample stripes(float x, float y) {
  const float wave = std::sin(kTwoPi * 4 * (x + y));
  return {ramp(-0.15F, 0.15F, wave), 0.95F + 0.1F * fractal(x, y, 20, 20, 3, 141)};
}

TextureSample pattern(Texture texture, float x, float y) {
  switch (texture) {
    case Texture::kPlain:
      return {0.9F + 0.1F * fractal(x, y, 4, 4, 4, 1), 0.96F + 0.08F * fractal(x, y, 32, 32, 3, 2)};
    case Texture::kPlaster:
      return plaster(x, y);
    case Texture::kBrick:
      return brick(x, y);
    case Texture::kPlanks:
      return planks(x, y);
    case Texture::kWeave:
      return weave(x, y);
    case Texture::kGrass:
      return grass(x, y);
    case Texture::kAsphalt:
      return asphalt(x, y);
    case Texture::kFoliage:
      return foliage(x, y);
    case Texture::kBark:
      return bark(x, y);
    case Texture::kFacade:
      return facade(x, y);
    case Texture::kTiles:
      return tiles(x, y);
    case Texture::kConcrete:
      return concrete(x, y);
    case Texture::kBooks:
      return books(x, y);
    case Texture::kPainting:
      return painting(x, y);
    case Texture::kStripes:
      return stripes(x, y);
  }
  return {};
}

// How often each pattern repeats along a metre, in the order of Texture.
constexpr std::array<float, kTextures> kTilesPerMetre{1.0F,  0.25F, 1.0F,     1 / 1.2F, 2.0F,
                                                      0.25F, 0.25F, 1 / 1.6F, 1 / 1.2F, 1 / 12.0F,
                                                      0.5F,  0.25F, 1.0F,     1.0F,     1.25F};

constexpr float kPhotographsPerMetre = 1;

}  // namespace

TextureSet::TextureSet() : texels_(kTexels * kTextures) {
  for (int i = 0; i < kTextures; ++i) {
    const auto texture = static_cast<Texture>(i);
    make(texture, [texture](int x, int y) {
      constexpr float kStep = 1.0F / kSide;
      const TextureSample s = pattern(texture, (static_cast<float>(x) + 0.5F) * kStep,
                                      (static_cast<float>(y) + 0.5F) * kStep);
      const auto mixed = static_cast<Texel>(std::lround(std::clamp(s.mix, 0.0F, 1.0F) * 255));
      const auto bright = static_cast<Texel>(std::lround(std::clamp(s.bright, 0.0F, 1.99F) * 128));
      return mixed | bright << 16;
    });
  }
}

void TextureSet::set_photographs(std::span<const Photograph> photographs) {
  static_assert(kSide == 2 * Photograph::kSide);
  const std::size_t count = std::min<std::size_t>(photographs.size(), kMostPhotographs);
  // Never fewer tiles: an older snapshot may still name the others.
  texels_.resize(std::max(texels_.size(), kTexels * (kTextures + count)));
  for (std::size_t i = 0; i < count; ++i) {
    const auto mirrored = [](int at) { return std::min(at, kSide - 1 - at); };
    make(photograph(static_cast<int>(i)), [&](int x, int y) {
      const int at = mirrored(y) * Photograph::kSide + mirrored(x);
      return photographs[i].grey[static_cast<std::size_t>(at)] | Texel{128} << 16;
    });
  }
}

// The widest level of what `texel_at`(column, row) says, and the others of it.
template <typename TexelAt>
void TextureSet::make(Texture texture, const TexelAt& texel_at) {
  Texel* level = texels_.data() + static_cast<std::size_t>(texture) * kTexels;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      level[static_cast<std::size_t>(y) * kSide + static_cast<std::size_t>(x)] = texel_at(x, y);
    }
  }
  for (std::size_t side = kSide / 2; side >= 1; side /= 2) {
    const Texel* finer = level;
    level += 4 * side * side;
    for (std::size_t y = 0; y < side; ++y) {
      for (std::size_t x = 0; x < side; ++x) {
        const Texel* corner = finer + (2 * y) * (2 * side) + 2 * x;
        const Texel sum = corner[0] + corner[1] + corner[2 * side] + corner[2 * side + 1];
        level[y * side + x] = ((sum + 0x00020002) >> 2) & 0x00FF00FF;
      }
    }
  }
}

float TextureSet::tiles_per_metre(Texture texture) {
  const auto index = static_cast<std::size_t>(texture);
  return index < kTilesPerMetre.size() ? kTilesPerMetre[index] : kPhotographsPerMetre / 2;
}

namespace {
TextureSet& the_set() {
  static TextureSet set;
  return set;
}
}  // namespace

const TextureSet& textures() { return the_set(); }

void use_photographs(std::span<const Photograph> photographs) {
  the_set().set_photographs(photographs);
}

}  // namespace lcdm::scene
