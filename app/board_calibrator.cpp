#include "app/board_calibrator.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <exception>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "firmware/vision/lens_map.h"

namespace lcdm {
namespace {

constexpr std::size_t kCells = 4;          // along each side of the picture
constexpr double kSmallestSquare = 10;     // pixels
constexpr double kBlurredEdge = 4;         // pixels from dark to light, of 640 across
constexpr double kSameView = 0.02;         // mean way of the corners, of the picture's diagonal
constexpr double kWorstError = 0.00125;    // RMS, of the picture's diagonal: 1 pixel of 640x480
constexpr int kFewestTilted = 4;           // views
constexpr double kWorstFocalError = 0.01;  // standard deviation of fx and fy, of themselves

Status refused(const std::string& text) {
  return Status::error(StatusCode::kUnavailable, "no calibration: %s", text.c_str());
}

// `format` has one place for a number.
std::string number(const char* format, double value) {
  char text[192];
  std::snprintf(text, sizeof(text), format, value);
  return text;
}

std::string percent(double share) { return number("%.0f %%", share * 100); }

// How often each cell of the grid holds a corner, row by row.
std::array<int, kCells * kCells> count_cells(const std::vector<std::vector<Point>>& views,
                                             int width, int height) {
  std::array<int, kCells * kCells> counts{};
  const auto cell = [](double at, int size) {
    return static_cast<std::size_t>(std::clamp(at * kCells / size, 0.0, kCells - 1.0));
  };
  for (const auto& view : views) {
    for (const Point& corner : view) {
      ++counts[cell(corner.y, height) * kCells + cell(corner.x, width)];
    }
  }
  return counts;
}

// The board's corners in squares, in its own plane.
std::vector<cv::Point3f> board_points(const BoardSize& board) {
  std::vector<cv::Point3f> points;
  for (int row = 0; row < board.rows; ++row) {
    for (int column = 0; column < board.columns; ++column) {
      points.emplace_back(static_cast<float>(column), static_cast<float>(row), 0.0F);
    }
  }
  return points;
}

// The least distance between neighbours of a row, pixels.
double smallest_square(const std::vector<cv::Point2f>& corners) {
  double smallest = cv::norm(corners[1] - corners[0]);
  for (std::size_t i = 2; i < corners.size(); ++i) {
    smallest = std::min(smallest, cv::norm(corners[i] - corners[i - 1]));
  }
  return smallest;
}

// All corners of the board, row by row, refined within their squares; none when one is missing.
std::vector<cv::Point2f> find_corners(const cv::Mat& grey, const cv::Size& board) {
  std::vector<cv::Point2f> corners;
  const int how =
      cv::CALIB_CB_ADAPTIVE_THRESH | cv::CALIB_CB_NORMALIZE_IMAGE | cv::CALIB_CB_FAST_CHECK;
  if (!cv::findChessboardCorners(grey, board, corners, how)) return {};
  const int reach = std::clamp(static_cast<int>(smallest_square(corners) * 0.4), 2, 11);
  cv::cornerSubPix(grey, corners, {reach, reach}, {-1, -1},
                   {cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 40, 1e-3});
  return corners;
}

// How many of the boards are turned away from the camera by at least kTilt.
int count_tilted(const std::vector<cv::Vec3d>& turns) {
  constexpr double kTilt = 0.25;  // radians
  return static_cast<int>(std::count_if(turns.begin(), turns.end(), [](const cv::Vec3d& turn) {
    cv::Matx33d rotation;
    cv::Rodrigues(turn, rotation);
    return std::acos(std::clamp(std::fabs(rotation(2, 2)), 0.0, 1.0)) > kTilt;
  }));
}

// What OpenCV makes of the views.
struct Solution {
  cv::Matx33d matrix = cv::Matx33d::eye();
  cv::Vec<double, 5> lens;
  std::vector<cv::Vec3d> turns;  // of each board
  std::vector<cv::Vec3d> places;
  cv::Mat deviations;  // standard deviations: fx, fy, ...
  double rms_error = 0;
};

CameraModel model_of(const Solution& solution, int width, int height) {
  CameraModel model;
  model.width = width;
  model.height = height;
  model.fx = static_cast<float>(solution.matrix(0, 0));
  model.fy = static_cast<float>(solution.matrix(1, 1));
  model.cx = static_cast<float>(solution.matrix(0, 2));
  model.cy = static_cast<float>(solution.matrix(1, 2));
  model.calibrated = true;
  for (int i = 0; i < 5; ++i) {
    model.distortion[static_cast<std::size_t>(i)] = static_cast<float>(solution.lens[i]);
  }
  return model;
}

// Whether to rely on it; the comparisons are false for what is no number.
Status check_solution(const Solution& solution, const CameraModel& model) {
  if (!(solution.rms_error <= kWorstError * std::hypot(model.width, model.height))) {
    return refused(
        number("the model misses the corners by %.2f pixels: is the board flat, its "
               "number of corners right, the camera's focus fixed?",
               solution.rms_error));
  }
  // Boards that all face the camera leave its focal length open, and no error shows it.
  if (count_tilted(solution.turns) < kFewestTilted) {
    return refused("the board was tilted in fewer than " + std::to_string(kFewestTilted) +
                   " views: tilt it, up to 45 degrees, to every side");
  }
  const double uncertainty = std::max(solution.deviations.at<double>(0) / solution.matrix(0, 0),
                                      solution.deviations.at<double>(1) / solution.matrix(1, 1));
  if (!(uncertainty <= kWorstFocalError)) {
    return refused(
        number("the focal length stays uncertain by %.1f %%: show the board nearer, and "
               "tilted to every side",
               uncertainty * 100));
  }
  const Status usable = pinhole_view(model, model.width, model.height).status();
  return usable ? usable : refused(usable.text());
}

}  // namespace

BoardCalibrator::BoardCalibrator(const BoardSize& board, int width, int height)
    : board_(board), width_(width), height_(height) {}

BoardCalibrator::Verdict BoardCalibrator::add(const RgbPicture& picture) {
  const cv::Mat rgb(picture.height, picture.width, CV_8UC3,
                    const_cast<std::uint8_t*>(picture.pixels.data()));
  const cv::Size size(board_.columns, board_.rows);
  cv::Mat grey;
  cv::cvtColor(rgb, grey, cv::COLOR_RGB2GRAY);
  const std::vector<cv::Point2f> found = find_corners(grey, size);
  if (found.empty()) return Verdict::kNoBoard;
  if (smallest_square(found) < kSmallestSquare) return Verdict::kTooFar;
  const double edge = cv::estimateChessboardSharpness(grey, size, found)[0];
  if (edge > std::max(1.0, width_ / 640.0) * kBlurredEdge) return Verdict::kBlurred;
  Corners corners;
  for (const cv::Point2f& corner : found) corners.push_back({corner.x, corner.y});
  if (repeated(corners)) return Verdict::kRepeated;
  corners_.push_back(std::move(corners));
  return Verdict::kTaken;
}

bool BoardCalibrator::repeated(const Corners& corners) const {
  const double limit = kSameView * std::hypot(width_, height_);
  return std::any_of(corners_.begin(), corners_.end(), [&](const Corners& taken) {
    double way = 0;
    for (std::size_t i = 0; i < corners.size(); ++i) {
      way += std::hypot(corners[i].x - taken[i].x, corners[i].y - taken[i].y);
    }
    return way < limit * static_cast<double>(corners.size());
  });
}

double BoardCalibrator::coverage() const {
  const auto counts = count_cells(corners_, width_, height_);
  const auto seen =
      counts.size() - static_cast<std::size_t>(std::count(counts.begin(), counts.end(), 0));
  return static_cast<double>(seen) / static_cast<double>(counts.size());
}

// The cell with the fewest corners; corners of the picture first, where the lens shows most.
std::string BoardCalibrator::where_next() const {
  struct Place {
    std::size_t cell;
    const char* name;
  };
  constexpr Place kPlaces[] = {
      {0, "at the top left"},      {3, "at the top right"}, {12, "at the bottom left"},
      {15, "at the bottom right"}, {4, "at the left"},      {7, "at the right"},
      {1, "at the top"},           {13, "at the bottom"},   {5, "in the middle"}};
  const auto counts = count_cells(corners_, width_, height_);
  return std::min_element(
             std::begin(kPlaces), std::end(kPlaces),
             [&](const Place& a, const Place& b) { return counts[a.cell] < counts[b.cell]; })
      ->name;
}

Result<Calibration> BoardCalibrator::solve() const {
  if (views() < kFewestViews) {
    return refused(std::to_string(views()) + " good views of the board, " +
                   std::to_string(kFewestViews) +
                   " are needed: show it in more places and turned in more ways");
  }
  if (coverage() < kLeastCoverage) {
    return refused("the views cover " + percent(coverage()) + " of the picture, " +
                   percent(kLeastCoverage) + " are needed: also hold the board " + where_next());
  }
  std::vector<std::vector<cv::Point2f>> seen;
  for (const Corners& view : corners_) {
    auto& points = seen.emplace_back();
    for (const Point& corner : view) {
      points.emplace_back(static_cast<float>(corner.x), static_cast<float>(corner.y));
    }
  }
  const std::vector<std::vector<cv::Point3f>> boards(seen.size(), board_points(board_));
  Solution solution;
  try {
    solution.rms_error = cv::calibrateCamera(boards, seen, {width_, height_}, solution.matrix,
                                             solution.lens, solution.turns, solution.places,
                                             solution.deviations, cv::noArray(), cv::noArray());
  } catch (const cv::Exception&) {
    return refused("the views contradict each other: take new ones, of a flat board");
  }
  const CameraModel model = model_of(solution, width_, height_);
  LCDM_RETURN_IF_ERROR(check_solution(solution, model));
  Calibration out;
  out.views = views();
  out.rms_error = solution.rms_error;
  out.model = model;
  return out;
}

const char* to_string(BoardCalibrator::Verdict verdict) {
  switch (verdict) {
    case BoardCalibrator::Verdict::kTaken:
      return "taken";
    case BoardCalibrator::Verdict::kNoBoard:
      return "no board, or not all of it";
    case BoardCalibrator::Verdict::kTooFar:
      return "too far away";
    case BoardCalibrator::Verdict::kBlurred:
      return "blurred";
    case BoardCalibrator::Verdict::kRepeated:
      return "like a view before";
  }
  return "";
}

}  // namespace lcdm
