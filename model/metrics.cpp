#include "model/metrics.h"

#include <algorithm>
#include <cmath>

#include "model/pack.h"

namespace lcdm::model {
namespace {

// Garg et al. 2016: rows and columns of the crop as shares of the picture.
constexpr double kTop = 0.40810811;
constexpr double kBottom = 0.99189189;
constexpr double kLeft = 0.03594771;
constexpr double kRight = 0.96405229;

// The middle value; of an even number the lower of the two would bias, so their mean.
double median_of(std::vector<float> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  if (values.size() % 2 == 1) return *middle;
  return (static_cast<double>(*middle) + *std::max_element(values.begin(), middle)) / 2;
}

constexpr double Metrics::*kMembers[] = {&Metrics::abs_rel,  &Metrics::sq_rel, &Metrics::rmse,
                                         &Metrics::rmse_log, &Metrics::delta1, &Metrics::delta2,
                                         &Metrics::delta3};

Metrics compare(const std::vector<float>& estimate, const std::vector<float>& truth) {
  Metrics m;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    const double p = estimate[i];
    const double g = truth[i];
    const double error = p - g;
    const double log_error = std::log(p / g);
    const double ratio = std::max(p / g, g / p);
    m.abs_rel += std::fabs(error) / g;
    m.sq_rel += error * error / g;
    m.rmse += error * error;
    m.rmse_log += log_error * log_error;
    m.delta1 += ratio < 1.25;
    m.delta2 += ratio < 1.25 * 1.25;
    m.delta3 += ratio < 1.25 * 1.25 * 1.25;
  }
  for (const auto member : kMembers) m.*member /= static_cast<double>(truth.size());
  m.rmse = std::sqrt(m.rmse);
  m.rmse_log = std::sqrt(m.rmse_log);
  return m;
}

}  // namespace

bool measure(const cv::Mat& estimate, const cv::Mat& truth, const Protocol& protocol,
             Metrics& metrics) {
  const cv::Mat resized =
      estimate.size() == truth.size() ? estimate : resize_inverse(estimate, truth.size());
  cv::Rect window(0, 0, truth.cols, truth.rows);
  if (protocol.garg_crop) {
    window.x = static_cast<int>(kLeft * truth.cols);
    window.y = static_cast<int>(kTop * truth.rows);
    window.width = static_cast<int>(kRight * truth.cols) - window.x;
    window.height = static_cast<int>(kBottom * truth.rows) - window.y;
  }
  std::vector<float> p;
  std::vector<float> g;
  for (int y = window.y; y < window.y + window.height; ++y) {
    for (int x = window.x; x < window.x + window.width; ++x) {
      const float depth = truth.at<float>(y, x);
      if (!(depth > protocol.nearest && depth < protocol.farthest)) continue;
      g.push_back(depth);
      p.push_back(resized.at<float>(y, x));
    }
  }
  if (g.empty()) return false;
  const double middle = median_of(p);
  if (!(middle > 0)) return false;
  const double scale = median_of(g) / middle;
  for (float& value : p) {
    value = static_cast<float>(
        std::clamp(static_cast<double>(value) * scale, protocol.nearest, protocol.farthest));
  }
  metrics = compare(p, g);
  return true;
}

Metrics mean_of(const std::vector<Metrics>& images) {
  Metrics mean;
  for (const Metrics& image : images) {
    for (const auto member : kMembers) {
      mean.*member += image.*member / static_cast<double>(images.size());
    }
  }
  return mean;
}

}  // namespace lcdm::model
