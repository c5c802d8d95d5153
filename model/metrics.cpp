#include "model/metrics.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "model/pack.h"

namespace lcdm::model {
namespace {

// Shares of the picture: Garg et al. 2016 for KITTI; Eigen et al. 2014 for NYU, rows 45 to 470 and
// columns 41 to 600 of 640x480.
struct Window {
  double top, bottom, left, right;
};
constexpr Window kGarg{0.40810811, 0.99189189, 0.03594771, 0.96405229};
constexpr Window kEigenIndoor{45.0 / 480, 471.0 / 480, 41.0 / 640, 601.0 / 640};

cv::Rect counted_part(Protocol::Crop crop, cv::Size size) {
  if (crop == Protocol::Crop::kNone) return {cv::Point(0, 0), size};
  const Window& window = crop == Protocol::Crop::kGarg ? kGarg : kEigenIndoor;
  return {cv::Point(static_cast<int>(window.left * size.width),
                    static_cast<int>(window.top * size.height)),
          cv::Point(static_cast<int>(window.right * size.width),
                    static_cast<int>(window.bottom * size.height))};
}

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

Result<Protocol> protocol_named(const std::string& name) {
  using Crop = Protocol::Crop;
  static const std::map<std::string, Protocol> protocols = {
      {"kitti", {1e-3, 80, Crop::kGarg}},      {"kitti-improved", {1e-3, 80, Crop::kNone}},
      {"nyu", {1e-3, 10, Crop::kEigenIndoor}}, {"make3d", {1e-3, 70, Crop::kNone}},
      {"rgbd", {0.1, 10, Crop::kNone}},        {"indoor", {0.3, 10, Crop::kNone}},
      {"scene", {0.3, 80, Crop::kNone}},
  };
  const auto found = protocols.find(name);
  if (found != protocols.end()) return found->second;
  std::string names;
  for (const auto& item : protocols) names += (names.empty() ? "" : ", ") + item.first;
  return Status::error(StatusCode::kInvalidInput, "\"%s\" is no protocol: use one of %s",
                       name.c_str(), names.c_str());
}

bool measure(const cv::Mat& estimate, const cv::Mat& truth, const Protocol& protocol,
             Metrics& metrics) {
  const cv::Mat resized =
      estimate.size() == truth.size() ? estimate : resize_inverse(estimate, truth.size());
  const cv::Rect window = counted_part(protocol.crop, truth.size());
  std::vector<float> p;
  std::vector<float> g;
  for (int y = window.y; y < window.y + window.height; ++y) {
    for (int x = window.x; x < window.x + window.width; ++x) {
      const float depth = truth.at<float>(y, x);
      if (!(depth > protocol.nearest && depth < protocol.farthest)) continue;
      g.push_back(depth);
      p.push_back(resized.at<float>(y, x));
      if (!(p.back() > 0)) return false;  // resizing makes 0 of what is no number
    }
  }
  if (g.empty()) return false;
  double scale = 1;
  if (protocol.median_scaling) {
    const double middle = median_of(p);
    if (!(middle > 0 && std::isfinite(middle))) return false;
    scale = median_of(g) / middle;
  }
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
