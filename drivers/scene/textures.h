// Surface patterns of the rendered scene: made once per process, with mip maps.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "drivers/scene/scene.h"

namespace lcdm::scene {

// Grey values of a square picture, row by row.
struct Photograph {
  static constexpr int kSide = 128;
  std::array<std::uint8_t, std::size_t{kSide} * kSide> grey;
};
constexpr int kMostPhotographs = 240;

// Every Texture as a tile of kSide x kSide texels with detail at all scales down to a texel, and
// its mip maps. Any number of threads may read at once.
class TextureSet {
 public:
  static constexpr int kSide = 256;
  static constexpr int kLevels = 9;  // 256, 128, ... 1

  // Low byte: where between the surface's dark (0) and light (255) colour; third byte: brightness
  // in 128ths. Two lanes that interpolate in one operation.
  using Texel = std::int32_t;

  TextureSet();

  // Photographs as further textures, mirrored at their sides so that they repeat without a seam;
  // at most kMostPhotographs. They take the place of the first of those there were.
  void set_photographs(std::span<const Photograph> photographs);

  // The pattern's levels one after another, the widest first, each [row][column].
  const Texel* tile(Texture texture) const {
    return texels_.data() + static_cast<std::size_t>(texture) * kTexels;
  }
  // How often the pattern repeats along a metre.
  static float tiles_per_metre(Texture texture);

 private:
  static constexpr std::size_t kTexels = (4 * kSide * kSide - 1) / 3;  // of all levels

  template <typename TexelAt>
  void make(Texture texture, const TexelAt& texel_at);

  std::vector<Texel> texels_;  // [texture][level][row][column]
};

// The process's one set; the first call makes it (some 0.1 s).
const TextureSet& textures();

// Gives it photographs, for a trainer's renderings. Nothing may be rendered meanwhile.
void use_photographs(std::span<const Photograph> photographs);

}  // namespace lcdm::scene
