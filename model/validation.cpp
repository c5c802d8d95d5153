#include "model/validation.h"

#include <map>
#include <numeric>

#include "model/evaluation.h"

namespace lcdm::model {
namespace {

std::vector<std::size_t> evenly(const std::vector<std::size_t>& all, std::size_t count) {
  std::vector<std::size_t> some;
  const std::size_t kept = std::min(all.size(), count);
  for (std::size_t i = 0; i < kept; ++i) some.push_back(all[i * all.size() / kept]);
  return some;
}

double mean_of(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

}  // namespace

Validation validate(DepthNetwork& network, int steps, double share, const Data& data,
                    std::size_t frames) {
  Validation out;
  const Estimator estimator = network_estimator(network, steps, share);
  std::map<Teacher, std::vector<double>> ratios;
  for (std::size_t i = 0; i < data.packs.size(); ++i) {
    const Pack& pack = data.packs[i];
    if (pack.use.teacher == Teacher::kNone) continue;  // nothing to measure by
    const auto some = evenly(pack.validation, frames);
    const SetResult network_result = evaluate(*pack.frames, some, data.protocols[i], estimator);
    if (network_result.frames.empty()) {
      if (network_result.missing > 0) out.fault = network_result.why_missing;
      continue;
    }
    out.missing += network_result.missing;
    const SetResult constant =
        evaluate(*pack.frames, some, data.protocols[i], constant_estimator());
    const double ratio = network_result.mean.abs_rel / std::max(1e-9, constant.mean.abs_rel);
    out.sets.push_back({pack.use.name, network_result.mean, constant.mean});
    ratios[pack.use.teacher].push_back(ratio);
  }
  if (!ratios.empty() && out.fault) out.score = mean_of(ratios.begin()->second);
  return out;
}

}  // namespace lcdm::model
