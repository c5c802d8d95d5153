// One network trained by several threads and processes at once, each on its part of a batch.
#pragma once

#include <vector>

#include "model/losses.h"
#include "model/processes.h"
#include "model/trained_networks.h"

namespace lcdm::model {

// The networks of a process's workers: the same weights in memory, gradients and statistics of each
// one's own. Worker 0 has the original. Each may be used by another thread; the functions here by
// one, while no other uses any.
class Replicas {
 public:
  Replicas(const TrainedNetworks& original, int workers);

  int size() const { return static_cast<int>(networks_.size()); }
  TrainedNetworks& of(int worker) { return networks_[static_cast<std::size_t>(worker)]; }
  std::vector<TrainedNetworks>& all() { return networks_; }

  // Everybody's statistics and configuration become the original's; the weights are its own.
  void broadcast_statistics();
  void clear_gradients();
  // Into the original: all gradients added up, all statistics averaged.
  void reduce();

 private:
  std::vector<TrainedNetworks> networks_;
};

// The same over all processes, in each of them the same bytes; and the losses, added up. Errors as
// Processes::sum; gradients and statistics are then nothing.
Status all_reduce(TrainedNetworks& networks, Processes& processes, Losses& losses);

}  // namespace lcdm::model
