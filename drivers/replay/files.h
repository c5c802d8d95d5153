// What `file:` finds on the disk: pictures in their order, and what is known about their camera.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/vision/camera_model.h"

namespace lcdm::replay {

// True for names that end in .jpg, .jpeg, .png, .bmp, .tif or .tiff, in any case.
bool is_image_name(std::string_view name);

// "frame2" before "frame10": runs of digits compare as numbers.
bool natural_less(std::string_view a, std::string_view b);

// The images of a folder in natural order. kNotFound when there are none.
Result<std::vector<std::string>> list_images(const std::string& folder);

// A file's bytes; kCorrupt when it is empty, larger than 256 MiB, or an image that is cut short or
// larger than 100 megapixels (decoders would fill in grey or take all memory).
Result<std::vector<std::uint8_t>> read_image_file(const std::string& path);

// Intrinsics from `intrinsics.json` in the folder or one up: keys width, height, fx, fy, cx, cy in
// pixels. A model of width 0 where there is no file or it gives no fx. kInvalidInput: a file that
// makes no sense.
Result<CameraModel> find_intrinsics(const std::string& folder);

}  // namespace lcdm::replay
