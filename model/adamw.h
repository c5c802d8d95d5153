// AdamW (arXiv 1711.05101) with its state in reach, so that a checkpoint resumes bit-exactly.
#pragma once

#include <functional>
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
  // Parameters without a gradient stay as they are. `rate_of` gives a parameter's learning rate by
  // its name.
  void step(const std::function<double(const std::string&)>& rate_of);

  // Moments and number of steps by parameter name, under `adam.`.
  void save(std::map<std::string, torch::Tensor>& tensors) const;
  // False where a tensor is missing or of another shape.
  bool load(const std::map<std::string, torch::Tensor>& tensors);

 private:
  struct Slot {
    std::string name;
    torch::Tensor parameter;
    torch::Tensor mean;
    torch::Tensor square;
    std::int64_t steps = 0;  // its own: some parameters join late
  };
  std::vector<Slot> slots_;
  double weight_decay_;
};

}  // namespace lcdm::model
