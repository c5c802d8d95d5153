// bfloat16 arithmetic for the operators that bear it, while the object lives; weights stay float.
// The one place that knows how LibTorch's versions call this.
#pragma once

#include <ATen/autocast_mode.h>
#include <torch/version.h>

#include "model/torch.h"

namespace lcdm::model {

class Autocast {
 public:
  explicit Autocast(c10::DeviceType device) : device_(device) {
    set(true);
    at::autocast::increment_nesting();
  }
  ~Autocast() {
    if (at::autocast::decrement_nesting() == 0) at::autocast::clear_cache();
    set(false);
  }
  Autocast(const Autocast&) = delete;
  Autocast& operator=(const Autocast&) = delete;

 private:
  void set(bool enabled) const {
#if TORCH_VERSION_MAJOR > 2 || (TORCH_VERSION_MAJOR == 2 && TORCH_VERSION_MINOR >= 4)
    at::autocast::set_autocast_dtype(device_, torch::kBFloat16);
    at::autocast::set_autocast_enabled(device_, enabled);
#else
    if (device_ == c10::kCUDA) {
      at::autocast::set_autocast_gpu_dtype(torch::kBFloat16);
      at::autocast::set_enabled(enabled);
    } else {
      at::autocast::set_autocast_cpu_dtype(torch::kBFloat16);
      at::autocast::set_cpu_enabled(enabled);
    }
#endif
  }

  c10::DeviceType device_;
};

}  // namespace lcdm::model
