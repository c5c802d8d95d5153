// The processes that train one network together, each on its part of every batch.
#pragma once

#include <memory>

#include "firmware/base/status.h"
#include "model/torch.h"

namespace lcdm::model {

class Processes {
 public:
  // Joins the others that torchrun's environment names: RANK, WORLD_SIZE, MASTER_ADDR, MASTER_PORT,
  // and TORCHELASTIC_USE_AGENT_STORE=True where torchrun itself listens there. Alone without
  // WORLD_SIZE. NCCL for CUDA, Gloo otherwise. Blocks until all have come. kInvalidInput: a
  // variable is missing or no number; kUnavailable: the others did not come, or this LibTorch was
  // built without the backend.
  static Result<std::shared_ptr<Processes>> join(const torch::Device& device);
  virtual ~Processes() = default;

  virtual int rank() const = 0;  // 0 saves and prints
  virtual int size() const = 0;
  // `values` of all processes added up, in place, the same bytes in every process. kUnavailable: a
  // process has gone; `values` are then nothing.
  virtual Status sum(torch::Tensor& values) = 0;
  // Whether it is so in any process. Errors as sum.
  Result<bool> any(bool mine);
};

// No others.
std::shared_ptr<Processes> alone();

// LOCAL_RANK: which of its machine's GPUs a process takes; 0 without it. kInvalidInput: no number.
Result<int> local_rank();

}  // namespace lcdm::model
