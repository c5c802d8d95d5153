#include "model/validation.h"

#include "model/evaluation.h"

namespace lcdm::model {
namespace {

std::vector<std::size_t> evenly(const std::vector<std::size_t>& all, std::size_t count) {
  std::vector<std::size_t> some;
  const std::size_t kept = std::min(all.size(), count);
  for (std::size_t i = 0; i < kept; ++i) some.push_back(all[i * all.size() / kept]);
  return some;
}

}  // namespace

Validation validate(DepthNetwork& network, int steps, double share, const Data& data,
                    std::size_t frames) {
  Validation out;
  const Estimator estimator = network_estimator(network, steps, share);
  double sensor_sum = 0;
  double sum = 0;
  std::size_t sensors = 0;
  for (std::size_t i = 0; i < data.packs.size(); ++i) {
    const Pack& pack = data.packs[i];
    const auto some = evenly(pack.validation, frames);
    const SetResult network_result = evaluate(*pack.frames, some, data.protocols[i], estimator);
    if (network_result.frames.empty()) continue;
    const SetResult constant =
        evaluate(*pack.frames, some, data.protocols[i], constant_estimator());
    const double ratio = network_result.mean.abs_rel / std::max(1e-9, constant.mean.abs_rel);
    out.sets.push_back({pack.use.name, network_result.mean, constant.mean});
    sum += ratio;
    if (pack.use.teacher == Teacher::kSensor) {
      sensor_sum += ratio;
      ++sensors;
    }
  }
  if (sensors > 0) {
    out.score = sensor_sum / static_cast<double>(sensors);
  } else if (!out.sets.empty()) {
    out.score = sum / static_cast<double>(out.sets.size());
  }
  return out;
}

}  // namespace lcdm::model
