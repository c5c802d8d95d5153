// Surface patterns of the rendered scene: made once per process, sampled with mip maps.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "drivers/scene.h"

namespace lcdm::scene {

struct TextureSample {
  float mix = 1;     // between the surface's dark (0) and light (1) colour
  float bright = 1;  // factor on top, about 1
};

// Every Texture as a tile of kSide x kSide texels with detail at all scales down to a texel, and
// its mip maps. Immutable once made: any number of threads may sample.
class TextureSet {
 public:
  static constexpr int kSide = 256;

  TextureSet();

  // At (u, v) metres on the surface, where a pixel covers `footprint` metres; trilinear.
  // Coordinates up to 4 km.
  TextureSample sample(Texture texture, float u, float v, float footprint) const;

 private:
  static constexpr int kLevels = 9;  // 256, 128, ... 1

  // Low byte: mix * 255; third byte: bright * 128. Two lanes that interpolate in one operation.
  using Texel = std::uint32_t;
  static constexpr std::size_t kTexels = (4 * kSide * kSide - 1) / 3;  // of all levels

  void make(Texture texture);
  static Texel bilinear(const Texel* level, int side, int x, int y);
  const Texel* tile(Texture texture) const {
    return texels_.data() + static_cast<std::size_t>(texture) * kTexels;
  }

  std::vector<Texel> texels_;  // [texture][level][row][column]
};

// The process's one set; the first call makes it (some 0.1 s).
const TextureSet& textures();

}  // namespace lcdm::scene
