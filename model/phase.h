// What losses and scores of a training can be compared within: the stage, with or without the head.
#pragma once

#include <cmath>
#include <cstddef>

namespace lcdm::model {

struct Phase {
  std::size_t stage = 0;  // of the recipe
  bool head = false;

  // As checkpoints keep it: the stage, and a half more with the head.
  static Phase from_number(float number) {
    if (!(number >= 0 && number < 1e6F)) return {};  // no checkpoint of ours
    return {static_cast<std::size_t>(number), number != std::floor(number)};
  }
  float number() const { return static_cast<float>(stage) + (head ? 0.5F : 0); }

  bool operator==(const Phase&) const = default;
};

}  // namespace lcdm::model
