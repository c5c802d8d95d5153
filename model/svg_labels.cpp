#include "model/svg_labels.h"

#include <cmath>
#include <utility>

#include "model/svg_axis.h"
#include "model/svg_elements.h"

namespace lcdm::model::svg {
namespace {

constexpr double kNameLetter = 7.2;  // at 12 px
constexpr double kNameHeight = 13;

struct LabelPlace {
  double x = 0;  // the text's baseline at its anchor
  double y = 0;
  int side = 0;  // -1: the text ends there, 0: its middle, 1: it starts there
  Box box{};
  std::vector<Box> leader;  // the line from a point to a label far from it, as steps
};

LabelPlace label_place(const Label& label, int right, int down, double distance) {
  const double width = text_width(label.text, kNameLetter);
  const double length = right != 0 && down != 0 ? distance * 0.75 : distance;
  LabelPlace place;
  place.side = right;
  place.x = label.point_x + right * length;
  const double middle = label.point_y + down * (length + (right == 0 ? kNameHeight / 2 : 0));
  place.y = middle + 4;
  const double left = place.x - (1 - right) * width / 2;
  place.box = {left, middle - kNameHeight / 2, left + width, middle + kNameHeight / 2};
  return place;
}

std::vector<Box> leader_to(const Label& label, const LabelPlace& place) {
  constexpr double kHalf = 3;
  std::vector<Box> steps;
  const double edge = std::clamp(label.point_y, place.box.top + 2, place.box.bottom - 2);
  for (const double share : {0.4, 0.6, 0.8, 1.0}) {
    const double x = label.point_x + share * (place.x - label.point_x);
    const double y = label.point_y + share * (edge - label.point_y);
    steps.push_back({x - kHalf, y - kHalf, x + kHalf, y + kHalf});
  }
  return steps;
}

// How much a label covers; what lies outside the frame counts most.
double cost_of(const LabelPlace& place, const std::vector<Box>& taken, const Box& frame_box) {
  double cost = 10 * (place.box.area() - place.box.overlap(frame_box));
  for (const Box& box : taken) {
    cost += place.box.overlap(box);
    for (const Box& step : place.leader) cost += 5 * step.overlap(box);
  }
  return cost;
}

// The first place around its point, near before far, where the label covers nothing; or the place
// where it covers least.
LabelPlace best_place(const Label& label, const std::vector<Box>& taken, const Box& frame_box) {
  static constexpr int kSides[][2] = {{1, 0},  {-1, 0},  {0, -1}, {0, 1},
                                      {1, -1}, {-1, -1}, {1, 1},  {-1, 1}};
  constexpr double kNear = 8;
  LabelPlace best;
  double least = INFINITY;
  for (const double distance : {kNear, 22.0, 38.0, 56.0}) {
    for (const auto& [right, down] : kSides) {
      LabelPlace place = label_place(label, right, down, distance);
      if (distance > kNear) place.leader = leader_to(label, place);
      const double cost = cost_of(place, taken, frame_box);
      if (cost >= least - 1e-6) continue;
      least = cost;
      best = std::move(place);
    }
    if (least <= 1e-6) break;
  }
  return best;
}

}  // namespace

std::string draw_labels(const std::vector<Label>& labels, std::vector<Box> taken,
                        const Box& frame_box) {
  static constexpr const char* kAnchors[] = {"end", "middle", "start"};
  std::string leaders;
  std::string texts;
  for (const Label& label : labels) {
    const LabelPlace place = best_place(label, taken, frame_box);
    taken.push_back(place.box);
    taken.insert(taken.end(), place.leader.begin(), place.leader.end());
    if (!place.leader.empty()) {
      leaders += line_from("leader", label.point_x, label.point_y, place.leader.back().centre_x(),
                           place.leader.back().centre_y());
    }
    texts += text_at("name", place.x, place.y, kAnchors[place.side + 1], label.text);
  }
  return leaders + texts;
}

}  // namespace lcdm::model::svg
