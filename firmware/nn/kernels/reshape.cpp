#include "firmware/nn/kernels/reshape.h"

#include <algorithm>
#include <cstddef>
#include <cstring>

namespace lcdm::kernels {
namespace {

// Calls copy(image offset, token offset) for every pixel of patch rows [begin, end).
template <typename Copy>
void for_each_token(const Patches& p, int begin, int end, Copy&& copy) {
  const auto channels = static_cast<std::size_t>(p.channels);
  const auto columns = static_cast<std::size_t>(p.width) / 2;
  const std::size_t tokens = static_cast<std::size_t>(p.height) / 2 * columns;
  for (auto row = static_cast<std::size_t>(begin); row < static_cast<std::size_t>(end); ++row) {
    for (std::size_t position = 0; position < 4; ++position) {
      for (std::size_t column = 0; column < columns; ++column) {
        const std::size_t y = 2 * row + position / 2;
        const std::size_t x = 2 * column + position % 2;
        const std::size_t token = position * tokens + row * columns + column;
        copy((y * static_cast<std::size_t>(p.width) + x) * channels, token * channels);
      }
    }
  }
}

// Where output index `i` falls: between input `low` and `high`, `fraction` of the way.
struct Tap {
  std::size_t low;
  std::size_t high;
  float fraction;
};

Tap tap_of(int i, int in_size, int out_size) {
  const float scale = static_cast<float>(in_size) / static_cast<float>(out_size);
  const float at = std::max(0.0F, (static_cast<float>(i) + 0.5F) * scale - 0.5F);
  const int low = std::min(static_cast<int>(at), in_size - 1);
  const int high = std::min(low + 1, in_size - 1);
  return {static_cast<std::size_t>(low), static_cast<std::size_t>(high),
          at - static_cast<float>(low)};
}

}  // namespace

void unfold_rows(const Patches& patches, const float* image, float* tokens, int begin, int end) {
  const std::size_t bytes = static_cast<std::size_t>(patches.channels) * sizeof(float);
  for_each_token(patches, begin, end, [&](std::size_t pixel, std::size_t token) {
    std::memcpy(tokens + token, image + pixel, bytes);
  });
}

void fold_rows(const Patches& patches, const float* tokens, float* image, int begin, int end) {
  const std::size_t bytes = static_cast<std::size_t>(patches.channels) * sizeof(float);
  for_each_token(patches, begin, end, [&](std::size_t pixel, std::size_t token) {
    std::memcpy(image + pixel, tokens + token, bytes);
  });
}

void resize_rows(const Resize& r, int begin, int end) {
  const auto channels = static_cast<std::size_t>(r.channels);
  const std::size_t pitch = static_cast<std::size_t>(r.in_width) * channels;
  for (int y = begin; y < end; ++y) {
    const Tap ty = tap_of(y, r.in_height, r.out_height);
    const float* top = r.input + ty.low * pitch;
    const float* bottom = r.input + ty.high * pitch;
    float* out =
        r.output + static_cast<std::size_t>(y) * static_cast<std::size_t>(r.out_width) * channels;
    for (int x = 0; x < r.out_width; ++x, out += channels) {
      const Tap tx = tap_of(x, r.in_width, r.out_width);
      const std::size_t left = tx.low * channels;
      const std::size_t right = tx.high * channels;
      for (std::size_t c = 0; c < channels; ++c) {
        const float a = top[left + c] + (top[right + c] - top[left + c]) * tx.fraction;
        const float b = bottom[left + c] + (bottom[right + c] - bottom[left + c]) * tx.fraction;
        out[c] = a + (b - a) * ty.fraction;
      }
    }
  }
}

}  // namespace lcdm::kernels
