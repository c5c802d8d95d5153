// The network of NETWORK.md once more, in plain loops and double precision: slow, obvious, and
// written from the page, not from firmware/nn. Only for small inputs.
#pragma once

#include <cstddef>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "tests/support/random_model.h"

namespace lcdm::test {

// [channels, height, width], or tokens [channels, position in the patch, patch].
struct Planes {
  int channels = 0;
  int height = 0;
  int width = 0;
  std::vector<double> values;

  Planes() = default;
  Planes(int c, int h, int w)
      : channels(c), height(h), width(w), values(static_cast<std::size_t>(c * h * w)) {}
  double& at(int c, int y, int x) { return values[index(c, y, x)]; }
  double at(int c, int y, int x) const { return values[index(c, y, x)]; }

 private:
  std::size_t index(int c, int y, int x) const {
    const int i = (c * height + y) * width + x;
    return static_cast<std::size_t>(i);
  }
};

// Output of every layer, by NETWORK.md's names, and `depth` in metres where the network's input
// has the canonical focal length. `rgb` is normalised, [height, width, 3].
std::map<std::string, Planes> run_reference(const ModelConfig& config,
                                            const std::vector<RandomTensor>& weights,
                                            std::span<const float> rgb, int width, int height);

}  // namespace lcdm::test
