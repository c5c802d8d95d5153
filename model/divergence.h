// Notices a training that has lost its way though every number of it is finite.
#pragma once

#include <cstddef>
#include <deque>
#include <limits>
#include <string>

#include "model/phase.h"
#include "model/torch.h"

namespace lcdm::model {

class Divergence {
 public:
  static constexpr std::size_t kWindow = 200;  // steps
  static constexpr double kWorst = 5;

  // Notes the loss of one step. Another phase begins anew: its losses are other sums.
  void add(double loss, Phase phase);
  // Whether the mean of the last kWindow losses exceeds kWorst times the least such mean. Each
  // counts as a hundred least means at most, so that it takes nine wild batches.
  bool found() const;
  // "the mean loss of ... is 3.2, it was 0.4".
  std::string text() const;

  // All of it as one row of numbers, for a checkpoint; and back.
  torch::Tensor numbers() const;
  void restore(const torch::Tensor& numbers);

 private:
  std::deque<float> recent_;
  float mean_ = 0;  // of a full window
  float least_ = std::numeric_limits<float>::infinity();
  Phase phase_;
};

}  // namespace lcdm::model
