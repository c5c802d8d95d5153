// AdamW (arXiv 1711.05101) with its state in reach, so that a checkpoint resumes bit-exactly.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "model/torch.h"

namespace lcdm::model {

class AdamW {
 public:
  // Biases, norms and other vectors are not decayed.
  AdamW(const torch::nn::Module& module, double weight_decay);

  // Scales all gradients so that their common norm is at most `limit`; returns the norm before.
  double clip(double limit);
  void step(double learning_rate);

  // Moments by parameter name, and the number of steps, under `adam.`.
  void save(std::map<std::string, torch::Tensor>& tensors) const;
  // False where a tensor is missing or of another shape.
  bool load(const std::map<std::string, torch::Tensor>& tensors);

 private:
  struct Slot {
    std::string name;
    torch::Tensor parameter;
    torch::Tensor mean;
    torch::Tensor square;
  };
  std::vector<Slot> slots_;
  double weight_decay_;
  std::int64_t steps_ = 0;
};

}  // namespace lcdm::model
