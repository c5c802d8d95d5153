// What every thread that computes beside others begins with.
#pragma once

#include "model/torch.h"

namespace lcdm::model {

// Of this thread: LibTorch works on it alone, since two whole passes side by side beat one on two
// threads, and subnormal numbers are zero: trained networks make many, and a step took 1.10 s, not
// .30.
inline void begin_worker_thread() {
  at::set_num_threads(1);
  at::globalContext().setFlushDenormal(true);
}

}  // namespace lcdm::model
