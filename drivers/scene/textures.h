// Surface patterns of the rendered scene: made once per process, with mip maps.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "drivers/scene/scene.h"

namespace lcdm::scene {

// Every Texture as a tile of kSide x kSide texels with detail at all scales down to a texel, and
// its mip maps. Immutable once made: any number of threads may read.
class TextureSet {
 public:
  static constexpr int kSide = 256;
  static constexpr int kLevels = 9;  // 256, 128, ... 1

  // Low byte: where between the surface's dark (0) and light (255) colour; third byte: brightness
  // in 128ths. Two lanes that interpolate in one operation.
  using Texel = std::int32_t;

  TextureSet();

  // The pattern's levels one after another, the widest first, each [row][column].
  const Texel* tile(Texture texture) const {
    return texels_.data() + static_cast<std::size_t>(texture) * kTexels;
  }
  // How often the pattern repeats along a metre.
  static float tiles_per_metre(Texture texture);

 private:
  static constexpr std::size_t kTexels = (4 * kSide * kSide - 1) / 3;  // of all levels

  void make(Texture texture);

  std::vector<Texel> texels_;  // [texture][level][row][column]
};

// The process's one set; the first call makes it (some 0.1 s).
const TextureSet& textures();

}  // namespace lcdm::scene
