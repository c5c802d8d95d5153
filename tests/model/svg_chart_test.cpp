// What a report's charts draw, read back from their SVG.
#include <algorithm>
#include <array>
#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <regex>
#include <string>
#include <utility>
#include <vector>

#include "tests/model/page_text.h"

namespace lcdm::model {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kTenth = 0.11;  // places are written to a tenth

struct Point {
  double x;
  double y;
};

// The places in text such as "M1 2L3 4" or "translate(1 2)".
std::vector<Point> places(const std::string& text) {
  static const std::regex kPlace(R"((-?[\d.]+) (-?[\d.]+))");
  std::vector<Point> found;
  for (std::sregex_iterator match(text.begin(), text.end(), kPlace), end; match != end; ++match) {
    found.push_back({std::stod((*match)[1]), std::stod((*match)[2])});
  }
  return found;
}

// A chart, as drawn.
class Drawn {
 public:
  static Drawn lines(const Chart& chart) {
    HtmlPage page("");
    page.line_chart(chart);
    return Drawn(body_of(page));
  }
  static Drawn points(const Chart& chart) {
    HtmlPage page("");
    page.scatter_chart(chart);
    return Drawn(body_of(page));
  }

  const std::string& html() const { return html_; }
  double left() const { return frame_[0]; }
  double top() const { return frame_[1]; }
  double right() const { return frame_[0] + frame_[2]; }
  double bottom() const { return frame_[1] + frame_[3]; }
  // Every series' path within the chart, not those of the legend.
  Texts paths() const { return all(svg_, R"re(<path class="line[^>]* d="([^"]*)")re"); }
  std::vector<Point> marks() const {
    std::vector<Point> found;
    for (const std::string& text : all(svg_, R"re(class="mark[^>]*translate\(([^)]*)\))re")) {
      found.push_back(places(text).at(0));
    }
    return found;
  }
  Texts x_ticks() const { return all(svg_, R"re(class="tick"[^>]*"middle">([^<]*)<)re"); }
  Texts y_ticks() const { return all(svg_, R"re(class="tick"[^>]*"end">([^<]*)<)re"); }
  Texts axis_texts() const { return all(svg_, R"re(class="axis"[^>]*>([^<]*)<)re"); }

 private:
  explicit Drawn(std::string html) : html_(std::move(html)) {
    svg_ = html_.substr(html_.find("<svg role=\"img\""));
    static const std::regex kFrame(
        R"re(class="frame" x="([\d.]+)" y="([\d.]+)" width="([\d.]+)" height="([\d.]+)")re");
    std::smatch match;
    EXPECT_TRUE(std::regex_search(svg_, match, kFrame));
    for (std::size_t i = 0; i < frame_.size(); ++i) frame_[i] = std::stod(match[i + 1]);
  }

  std::string html_;
  std::string svg_;
  std::array<double, 4> frame_{};  // left, top, width, height
};

void expect_at(const Point& point, double x, double y) {
  EXPECT_NEAR(point.x, x, kTenth);
  EXPECT_NEAR(point.y, y, kTenth);
}

TEST(LineChart, SpansTheFrameBetweenNiceTicks) {
  const Drawn drawn = Drawn::lines(chart_of({0, 50, 100}, {0, 1, 5}));
  const std::vector<Point> points = places(drawn.paths().at(0));
  ASSERT_EQ(points.size(), 3U);
  expect_at(points[0], drawn.left(), drawn.bottom());
  expect_at(points[1], (drawn.left() + drawn.right()) / 2,
            drawn.bottom() - (drawn.bottom() - drawn.top()) / 5);
  expect_at(points[2], drawn.right(), drawn.top());
  EXPECT_EQ(drawn.x_ticks(), (Texts{"0", "20", "40", "60", "80", "100"}));
  EXPECT_EQ(drawn.y_ticks(), (Texts{"0", "1", "2", "3", "4", "5"}));
  EXPECT_EQ(drawn.axis_texts(), (Texts{"loss", "step"}));
}

TEST(LineChart, TicksAreRoundAndTheirTextsAlike) {
  EXPECT_EQ(Drawn::lines(chart_of({0, 1}, {0.31, 0.17})).y_ticks(),
            (Texts{"0.15", "0.20", "0.25", "0.30", "0.35"}));
  EXPECT_EQ(Drawn::lines(chart_of({0, 1}, {-0.1, 0.2})).y_ticks(),
            (Texts{"-0.10", "-0.05", "0", "0.05", "0.10", "0.15", "0.20"}));
  EXPECT_EQ(Drawn::lines(chart_of({0, 1}, {0, 3e-4})).y_ticks(),
            (Texts{"0", "5e-5", "1e-4", "1.5e-4", "2e-4", "2.5e-4", "3e-4"}));
  EXPECT_EQ(Drawn::lines(chart_of({0, 1}, {1e8, 3e8})).y_ticks(),
            (Texts{"1e8", "1.5e8", "2e8", "2.5e8", "3e8"}));
}

TEST(LineChart, LongTickTextsHaveRoomBesideEachOther) {
  for (const double seconds : {0.1, 0.7, 3.0, 40.0, 600.0}) {
    const Drawn drawn = Drawn::lines(chart_of({1.7e9 + 0.1, 1.7e9 + 0.1 + seconds}, {1, 2}));
    const Texts ticks = drawn.x_ticks();
    ASSERT_FALSE(ticks.empty());
    double width = 0;
    for (const std::string& tick : ticks) width += 7.5 * static_cast<double>(tick.size());
    EXPECT_LT(width, drawn.right() - drawn.left()) << seconds;
  }
}

TEST(LineChart, ALogarithmicAxisGivesEqualFactorsEqualRoom) {
  Chart chart = chart_of({0, 1, 2}, {100, 1, 0.01});
  chart.log_y = true;
  const Drawn drawn = Drawn::lines(chart);
  const std::vector<Point> points = places(drawn.paths().at(0));
  ASSERT_EQ(points.size(), 3U);
  EXPECT_NEAR(points[1].y - points[0].y, points[2].y - points[1].y, 2 * kTenth);
  EXPECT_EQ(drawn.y_ticks(), (Texts{"0.01", "0.1", "1", "10", "100"}));

  chart.series[0].y = {1, 2, 10};
  EXPECT_EQ(Drawn::lines(chart).y_ticks(), (Texts{"1", "2", "5", "10"}));
  chart.series[0].y = {3.1, 3.2, 3.4};  // no power of ten between: ticks as on a linear axis
  EXPECT_GE(Drawn::lines(chart).y_ticks().size(), 3U);
}

TEST(LineChart, BreaksWhereAValueIsNotFinite) {
  const Drawn drawn =
      Drawn::lines(chart_of({0, 1, 2, 3, 4, 5, 6}, {1, 2, kNaN, 3, kInfinity, 4, 5}));
  EXPECT_EQ(all(drawn.paths().at(0), "([ML])"), (Texts{"M", "L", "M", "M", "L"}));
  EXPECT_EQ(drawn.html().find("nan"), std::string::npos);
  EXPECT_EQ(drawn.html().find("inf"), std::string::npos);
}

TEST(LineChart, BreaksWhereALogarithmicAxisHasNoPlace) {
  Chart chart = chart_of({0, 1, 2, 3}, {1, 0, -1, 2});
  chart.log_y = true;
  EXPECT_EQ(all(Drawn::lines(chart).paths().at(0), "([ML])"), (Texts{"M", "M"}));
}

TEST(LineChart, AValueAloneIsAMark) {
  std::vector<double> x(100);
  std::vector<double> y(100, 1.0);
  for (std::size_t i = 0; i < x.size(); ++i) x[i] = static_cast<double>(i);
  y[49] = y[51] = kNaN;
  const Drawn drawn = Drawn::lines(chart_of(x, y));
  ASSERT_EQ(drawn.marks().size(), 1U);
  EXPECT_NEAR(drawn.marks()[0].x, drawn.left() + (drawn.right() - drawn.left()) * 50 / 99, kTenth);
}

TEST(LineChart, ThinsManyPointsAndKeepsTheExtremesAndTheEnds) {
  constexpr std::size_t kMany = 100'000;
  std::vector<double> x(kMany);
  std::vector<double> y(kMany);
  for (std::size_t i = 0; i < kMany; ++i) {
    x[i] = static_cast<double>(i);
    y[i] = 5 + std::sin(static_cast<double>(i));
  }
  y[31'234] = 10;
  y[77'777] = 0;
  const Drawn drawn = Drawn::lines(chart_of(x, y));
  const std::vector<Point> points = places(drawn.paths().at(0));
  EXPECT_LE(points.size(), 502U);
  EXPECT_GE(points.size(), 400U);
  const auto [high, low] = std::minmax_element(
      points.begin(), points.end(), [](const Point& a, const Point& b) { return a.y < b.y; });
  const double width = drawn.right() - drawn.left();
  expect_at(*high, drawn.left() + width * 0.31234, drawn.top());
  expect_at(*low, drawn.left() + width * 0.77777, drawn.bottom());
  EXPECT_NEAR(points.front().x, drawn.left(), kTenth);
  EXPECT_NEAR(points.back().x, drawn.right(), kTenth);
}

TEST(LineChart, NamesEverySeriesThatHasAName) {
  Chart chart = chart_of({0, 1}, {0, 1});
  chart.series.push_back({"", {0, 1}, {1, 0}});
  chart.series.push_back({"denoising", {0, 1}, {1, 1}});
  const Drawn drawn = Drawn::lines(chart);
  EXPECT_EQ(all(drawn.html(), R"re(</svg>([^<]+)</span>)re"), (Texts{"total", "denoising"}));
  EXPECT_EQ(drawn.paths().size(), 3U);
}

// --- Charts of little data -----------------------------------------------------------------------

TEST(Charts, WithoutDataSaySo) {
  const Chart none{.title = "t", .x_label = "step", .y_label = "loss", .series = {}};
  for (const Drawn& drawn :
       {Drawn::lines(none), Drawn::points(none), Drawn::lines(chart_of({}, {})),
        Drawn::lines(chart_of({0, 1}, {kNaN, kInfinity}))}) {
    EXPECT_EQ(drawn.axis_texts(), (Texts{"loss", "step", "no data"}));
    EXPECT_TRUE(drawn.paths().empty());
    EXPECT_TRUE(drawn.marks().empty());
  }
}

TEST(Charts, OfOnePointShowItInTheMiddle) {
  for (const bool log : {false, true}) {
    Chart chart = chart_of({7}, {0.3});
    chart.log_x = chart.log_y = log;
    for (const Drawn& drawn : {Drawn::lines(chart), Drawn::points(chart)}) {
      ASSERT_EQ(drawn.marks().size(), 1U);
      EXPECT_GT(drawn.marks()[0].x, drawn.left() + 100);
      EXPECT_LT(drawn.marks()[0].x, drawn.right() - 100);
      EXPECT_GT(drawn.marks()[0].y, drawn.top() + 50);
      EXPECT_LT(drawn.marks()[0].y, drawn.bottom() - 50);
      EXPECT_FALSE(drawn.x_ticks().empty());
      EXPECT_FALSE(drawn.y_ticks().empty());
    }
  }
}

TEST(Charts, OfValuesAllEqualOrExtremeStayWithinTheFrame) {
  for (const std::vector<double>& y : std::vector<std::vector<double>>{
           {0, 0, 0},
           {-3, -3, -3},
           {1e9, 1e9 + 1e-6, 1e9},
           {-1e99, 0, 1e99},
           {1e-90, 2e-90, 3e-90},
           {std::numeric_limits<double>::max(), std::numeric_limits<double>::lowest(), 1}}) {
    const Drawn drawn = Drawn::lines(chart_of({1, 2, 3}, y));
    for (const Point& mark : drawn.marks()) {
      EXPECT_GE(mark.x, drawn.left() - kTenth);
      EXPECT_LE(mark.x, drawn.right() + kTenth);
      EXPECT_GE(mark.y, drawn.top() - kTenth);
      EXPECT_LE(mark.y, drawn.bottom() + kTenth);
    }
    EXPECT_FALSE(drawn.marks().empty());
    EXPECT_LE(drawn.y_ticks().size(), 12U);
  }
}

TEST(Charts, OfUnevenColumnsShowThePairs) {
  EXPECT_EQ(Drawn::points(chart_of({1, 2, 3}, {1, 2})).marks().size(), 2U);
}

// --- Scatter charts ------------------------------------------------------------------------------

struct Label {
  double left;
  double baseline;
  double right;
};

std::vector<Label> labels_of(const Drawn& drawn) {
  static const std::regex kLabel(
      R"re(class="name" x="([\d.]+)" y="([\d.]+)" text-anchor="(\w+)">([^<]*)<)re");
  std::vector<Label> found;
  const std::string& html = drawn.html();
  for (std::sregex_iterator match(html.begin(), html.end(), kLabel), end; match != end; ++match) {
    const double width = 6.5 * static_cast<double>((*match)[4].length());
    const double x = std::stod((*match)[1]);
    const double left = (*match)[3] == "start" ? x
                        : (*match)[3] == "end" ? x - width
                                               : x - width / 2;
    found.push_back({left, std::stod((*match)[2]), left + width});
  }
  return found;
}

TEST(ScatterChart, SetsALabelBesideItsPoint) {
  Chart chart = chart_of({1, 2, 3}, {1, 2, 3});
  chart.series[0].labels = {"", "small & fast", ""};
  const Drawn drawn = Drawn::points(chart);
  ASSERT_EQ(labels_of(drawn).size(), 1U);
  EXPECT_NEAR(labels_of(drawn)[0].left, drawn.marks()[1].x + 8, kTenth);
  EXPECT_NEAR(labels_of(drawn)[0].baseline, drawn.marks()[1].y + 4, kTenth);
  EXPECT_NE(drawn.html().find(">small &amp; fast</text>"), std::string::npos);
  EXPECT_NE(drawn.html().find("<title>small &amp; fast: 2; 2</title>"), std::string::npos);
}

TEST(ScatterChart, LabelsOfPointsCloseTogetherDoNotCoverEachOther) {
  Chart chart = chart_of({1.4, 1.45, 3, 3.1, 25, 25.2, 97, 335, 330},
                         {.19, .187, .165, .163, .065, .064, .06, .056, .057});
  chart.log_x = true;
  chart.series[0].labels = {"METER XS",         "METER XXS",        "METER S",
                            "METER S again",    "Depth Anything S", "Depth Anything V2 S",
                            "Depth Anything B", "Depth Anything L", "Depth Anything V2 L"};
  const Drawn drawn = Drawn::points(chart);
  const std::vector<Label> labels = labels_of(drawn);
  ASSERT_EQ(labels.size(), 9U);
  for (std::size_t i = 0; i < labels.size(); ++i) {
    EXPECT_GE(labels[i].left, drawn.left());
    EXPECT_LE(labels[i].right, drawn.right());
    for (std::size_t k = 0; k < i; ++k) {
      const bool beside = labels[i].right < labels[k].left || labels[k].right < labels[i].left;
      EXPECT_TRUE(beside || std::abs(labels[i].baseline - labels[k].baseline) > 11)
          << i << " " << k;
    }
  }
}

TEST(ScatterChart, ALogarithmicAxisGivesEqualFactorsEqualRoom) {
  Chart chart = chart_of({1, 10, 100}, {1, 2, 3});
  chart.log_x = true;
  const Drawn drawn = Drawn::points(chart);
  const std::vector<Point> marks = drawn.marks();
  EXPECT_NEAR(marks[1].x - marks[0].x, marks[2].x - marks[1].x, 2 * kTenth);
  EXPECT_EQ(drawn.x_ticks(), (Texts{"1", "2", "5", "10", "20", "50", "100"}));
}

}  // namespace
}  // namespace lcdm::model
