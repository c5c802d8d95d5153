// Batches made ahead on worker threads, so that the training step never waits for a picture.
#pragma once

#include <array>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <mutex>
#include <thread>
#include <torch/types.h>
#include <vector>

#include "model/dataset.h"

namespace lcdm::model {

struct Batch {
  torch::Tensor image;  // [B, 3, H, W]
  torch::Tensor depth;  // [B, 1, H, W]
  std::vector<bool> reliable_scale;
};

// Where training frames come from, and how often.
struct Source {
  std::vector<const Frame*> frames;
  bool reliable_scale = false;
  double weight = 1;  // share of the batches
};

// A batch holds one source and one shape: normalisation statistics then belong together.
// The n-th batch depends on the seed and n alone, however many workers make them.
class BatchMaker {
 public:
  struct Options {
    std::vector<std::array<int, 2>> shapes;  // width, height; taken in turn
    int batch_size = 4;
    double canonical_focal = 320;
    AugmentOptions augment;
    std::uint64_t seed = 1;
    std::uint64_t first = 0;  // number of the first batch: where a resumed run goes on
    int workers = 1;
  };

  BatchMaker(std::vector<Source> sources, Options options);
  ~BatchMaker();
  BatchMaker(const BatchMaker&) = delete;
  BatchMaker& operator=(const BatchMaker&) = delete;

  Batch next();

 private:
  struct Slot {
    std::uint64_t number;
    Batch batch;
  };

  void work();
  Batch make(std::uint64_t number) const;

  const std::vector<Source> sources_;
  const Options options_;
  std::mutex mutex_;  // guards what follows
  std::condition_variable changed_;
  std::uint64_t next_to_make_;
  std::uint64_t next_to_give_;
  std::deque<Slot> ready_;
  bool stopping_ = false;
  std::vector<std::thread> threads_;
};

// Mean and deviation of the teacher's disparity logit over `batches` batches: what standardises the
// diffusion variable (preset lcdm).
struct VariableStatistics {
  double mean = 0;
  double deviation = 1;
};
VariableStatistics measure_variable(BatchMaker& batches, int count);

}  // namespace lcdm::model
