// AdamW (arXiv 1711.05101), or Muon for matrices beside it, with all state in reach, so that a
// checkpoint resumes bit-exactly.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "model/torch.h"

namespace lcdm::model {

enum class OptimizerKind : std::uint8_t {
  kAdamW,
  kMuon,  // for the depth network's matrices; AdamW for the rest
};

class Optimizer {
 public:
  // Biases, norms and other vectors are not decayed. `threads` share the work; the weights do not
  // depend on their number.
  Optimizer(OptimizerKind kind, const torch::nn::Module& module, double weight_decay, int threads);

  // Scales all gradients so that their common norm is at most `limit`; returns the norm before.
  double clip(double limit);
  // Parameters without a gradient stay as they are. `rate_of` gives a parameter's learning rate by
  // its name.
  void step(const std::function<double(const std::string&)>& rate_of);

  // Moments and number of steps by parameter name, under `adam.` and `muon.`.
  void save(std::map<std::string, torch::Tensor>& tensors) const;
  // False where a tensor is missing or of another shape: the other optimiser's state too.
  bool load(const std::map<std::string, torch::Tensor>& tensors);

 private:
  struct Slot {
    std::string name;
    torch::Tensor parameter;
    torch::Tensor mean;      // Muon's momentum, where there is no `square`
    torch::Tensor square;    // none where Muon serves the parameter
    std::int64_t steps = 0;  // its own: some parameters join late

    bool muon() const { return !square.defined(); }
  };
  // What changes alike and so in one go: a GPU would wait for the many small changes one by one.
  struct Group {
    bool muon = false;  // all of them, and as matrices of one shape
    double rate = 0;
    std::int64_t steps = 0;  // of each, before this one
    std::vector<Slot*> slots;
  };
  // Of the slots that have a gradient; each of a few slots at most.
  std::vector<Group> groups(const std::function<double(const std::string&)>& rate_of);
  void change(const Group& group) const;

  std::vector<Slot> slots_;
  double weight_decay_;
  int threads_;
};

}  // namespace lcdm::model
