#include "model/learned_cameras.h"

namespace lcdm::model {

LearnedCamerasImpl::LearnedCamerasImpl(std::int64_t cameras) {
  log_focal = register_parameter("log_focal", torch::zeros({2 * cameras}));
}

Pinholes LearnedCamerasImpl::forward(const Pinholes& assumed, const torch::Tensor& which) {
  const torch::Tensor known = torch::zeros({2}, log_focal.options());
  const torch::Tensor factor = torch::cat({known, log_focal})
                                   .reshape({-1, 2})
                                   .index_select(0, which + 1)
                                   .exp()
                                   .reshape({-1, 2, 1, 1});
  return {assumed.fx * factor.narrow(1, 0, 1), assumed.fy * factor.narrow(1, 1, 1), assumed.cx,
          assumed.cy};
}

}  // namespace lcdm::model
