// Pictures and exact depth of a scene, by casting rays.
#pragma once

#include <cstdint>
#include <span>

#include "drivers/scene/scene.h"
#include "firmware/vision/camera_model.h"

namespace lcdm::scene {

// Renders what `camera` sees of the scene at `seconds`.
// rgb: [height][width][3], anti-aliased at edges. depth: [height][width] metres along the optical
// axis through each pixel's centre, 0 for the sky; may be empty when not wanted.
// Re-entrant, no heap once textures() were made, uses about 150 KiB of stack.
void render(const Scene& scene, double seconds, const CameraModel& camera,
            std::span<std::uint8_t> rgb, std::span<float> depth);

// The same for a snapshot that the caller keeps.
void render(const Snapshot& snapshot, const CameraModel& camera, std::span<std::uint8_t> rgb,
            std::span<float> depth);

}  // namespace lcdm::scene
