// The page of `lcdm-train report`, held against the files it is about and what other commands say.
#include <array>
#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>
#include <iterator>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "model/csv.h"
#include "model/exporter.h"
#include "model/safetensors.h"
#include "tests/app/program.h"
#include "tests/model/page_text.h"
#include "tests/support/temporary_folder.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;

constexpr int kPictures = 40;  // of the pack, of which the last four validate

// From `begin` to the next `end`; empty, and a failure, where there is none.
std::string part(const std::string& text, const std::string& begin, const std::string& end) {
  const std::size_t from = text.find(begin);
  const std::size_t to = text.find(end, from == std::string::npos ? from : from + begin.size());
  EXPECT_NE(to, std::string::npos) << begin << " ... " << end;
  return to == std::string::npos ? "" : text.substr(from, to - from);
}

// The numbers of every row of a name in the table whose first column is called `table`.
std::vector<Texts> rows_of(const std::string& page, const std::string& table,
                           const std::string& name) {
  const std::string text = part(page, "<th scope=\"col\">" + table + "</th>", "</table>");
  std::vector<Texts> rows;
  for (const std::string& row : all(text, "<th scope=\"row\">" + name + "</th>([^\n]*)</tr>")) {
    rows.push_back(all(row, "<td>([^<]*)</td>"));
  }
  return rows;
}

std::string chart_in(const std::string& page, const std::string& title) {
  return part(page, "<figcaption>" + title + "</figcaption>", "</figure>");
}
// Where the marks of a line chart's series are: to the right, and downwards.
std::vector<cv::Point2d> marks(const std::string& chart, int series) {
  const std::string drawing = part(chart, "<svg role=", "</svg>");
  const std::string number = std::to_string(series);
  std::vector<cv::Point2d> found;
  for (const std::string& place :
       all(drawing, "class=\"mark s" + number + R"(" transform="translate\(([^)]*)\))")) {
    found.emplace_back(std::stod(place), std::stod(place.substr(place.find(' '))));
  }
  return found;
}

// As it is shown: three digits.
void expect_shown(const std::string& shown, double value, const std::string& what) {
  ASSERT_FALSE(shown.empty()) << what;
  EXPECT_NEAR(std::stod(shown), value, 0.0051 * std::abs(value)) << what;
}

class Report : public testing::Test {
 protected:
  Report() {
    for (const char* kind : {"rgb", "depth"}) fs::create_directories(pack_ / kind);
    for (int i = 0; i < kPictures; ++i) {
      const std::string name = std::to_string(100 + i) + ".png";
      cv::Mat rgb(48, 64, CV_8UC3);
      cv::Mat depth(48, 64, CV_16U);
      cv::randu(rgb, 0, 256);
      cv::randu(depth, 1000, 3000);
      cv::imwrite((pack_ / "rgb" / name).string(), rgb);
      cv::imwrite((pack_ / "depth" / name).string(), depth);
    }
    std::ofstream(pack_ / "intrinsics.json")
        << R"({"width": 64, "height": 48, "depth_unit_m": 0.001, "fx": 50, "fy": 50, "cx": 32, )"
           R"("cy": 24})";
  }

  // A network of the smallest size with weights that nobody trained.
  std::string model(const std::string& name, EncoderKind encoder) const {
    torch::manual_seed(5);
    ModelConfig config;
    config.encoder = encoder;
    config.trained_sizes = {{64, 64}};
    config.name = name;
    config.licence = config.card = "none";
    DepthNetwork network(config);
    network->eval();
    std::string path = folder_.file(name + ".safetensors");
    const Status written = export_network(network, path);
    EXPECT_TRUE(written) << written.text();
    return path;
  }
  void run(std::vector<std::string> arguments) const {
    arguments.insert(arguments.end(), {"--pack", pack_.string(), "--scene-frames", "0"});
    test::Program program(LCDM_TRAIN_PROGRAM, arguments);
    ASSERT_EQ(program.wait(120), 0) << program.text();
  }
  // What the page's body holds.
  std::string report(const std::vector<std::string>& models,
                     const std::vector<std::string>& more = {}) const {
    const std::string path = folder_.file("report.html");
    std::vector<std::string> arguments = {"report", "--output", path};
    for (const std::string& each : models) arguments.insert(arguments.end(), {"--model", each});
    arguments.insert(arguments.end(), more.begin(), more.end());
    run(arguments);
    std::ifstream file(path);
    const std::string html{std::istreambuf_iterator<char>(file), {}};
    return part(html, "<body>", "</body>");
  }
  // The figures of `evaluate` for a model and for a constant depth, means over the frames.
  std::map<std::string, std::vector<double>> evaluated(const std::string& model) const {
    const std::string path = folder_.file("frames.csv");
    run({"evaluate", "--model", model, "--frames", path});
    std::map<std::string, std::vector<double>> means;
    const auto table = read_csv(path);
    EXPECT_TRUE(table) << table.status().text();
    const auto estimates = *table->texts("estimate");
    for (const char* figure : {"abs_rel", "sq_rel", "rmse", "rmse_log", "d1", "d2", "d3"}) {
      const auto values = *table->numbers(figure);
      std::map<std::string, double> sums;
      for (std::size_t i = 0; i < values.size(); ++i) sums[estimates[i]] += values[i];
      for (const auto& [estimate, sum] : sums) means[estimate].push_back(sum / 4);
    }
    return means;
  }

  test::TemporaryFolder folder_;
  const fs::path pack_ = folder_.file("pack");
};

double millions_in(const std::string& model) {
  const auto file = read_tensors(model);
  EXPECT_TRUE(file) << file.status().text();
  std::int64_t count = 0;
  for (const auto& [name, tensor] : file->tensors) count += tensor.numel();
  return 1e-6 * static_cast<double>(count);
}

// 1.73 M and 2.42 G are the specification's, NETWORK.md.
TEST_F(Report, SaysWhatAModelCostsAtEachOfItsSizes) {
  const std::string shipped = "model/weights/lcdm-xxs.safetensors";
  const std::string page = report({shipped, model("small", EncoderKind::kXs)});
  const std::vector<Texts> rows = rows_of(page, "model", "lcdm-xxs");
  ASSERT_EQ(rows.size(), 2U);
  EXPECT_EQ(rows[0][0], "640x192");
  EXPECT_EQ(rows[1][0], "256x192");
  for (const Texts& row : rows) {
    EXPECT_NEAR(std::stod(row[1]), 1.73, 0.01);
    expect_shown(row[1], millions_in(shipped), "parameters");
    EXPECT_GT(std::stod(row[4]), 0) << "milliseconds";
  }
  EXPECT_NEAR(std::stod(rows[0][2]), 2.42, 0.011) << "GMAC";
  EXPECT_LT(std::stod(rows[1][2]), 2.42 * 256 / 640) << "attention is not linear in the size";
  EXPECT_GT(std::stod(rows[1][2]), 0.9 * 2.42 * 256 / 640);
  const std::vector<Texts> small = rows_of(page, "model", "small");
  ASSERT_EQ(small.size(), 1U);
  EXPECT_EQ(small[0][0], "64x64");
  expect_shown(small[0][1], millions_in(folder_.file("small.safetensors")), "parameters");
}

TEST_F(Report, GivesTheAccuracyThatEvaluateGives) {
  const std::string first = model("first", EncoderKind::kXxs);
  const std::string second = model("second", EncoderKind::kXs);
  const std::string page = report({first, second});
  auto wanted = evaluated(first);
  wanted.merge(evaluated(second));
  ASSERT_EQ(wanted.size(), 3U);
  ASSERT_NE(wanted["first"], wanted["second"]);
  for (const auto& [name, figures] : wanted) {
    const std::vector<Texts> rows = rows_of(page, "pack", name);
    ASSERT_EQ(rows.size(), 1U) << name;
    ASSERT_EQ(rows[0].size(), 1U + figures.size() + 1) << name;
    EXPECT_EQ(rows[0][0], "4") << name;
    for (std::size_t i = 0; i < figures.size(); ++i) {
      expect_shown(rows[0][1 + i], figures[i], name + ", figure " + std::to_string(i));
    }
  }
  EXPECT_EQ(rows_of(page, "pack", "first")[0].back(), "") << "no difference to itself";
  const std::string difference = rows_of(page, "pack", "constant")[0].back();
  const double mean = wanted["constant"][0] - wanted["first"][0];
  EXPECT_NEAR(std::stod(difference), mean, 0.051 * std::abs(mean)) << difference;
}

// A set's series has a point for each model, and none for a constant depth.
TEST_F(Report, PlotsEachModelsParametersAgainstItsD1) {
  const std::string first = model("first", EncoderKind::kXxs);
  const std::string second = model("second", EncoderKind::kXs);
  const std::string chart = chart_in(report({first, second}), "Parameters against d1");
  const std::string title = "\"[^>]*><title>([^<]*)</title>";
  const Texts points = all(chart, "class=\"mark s0" + title);
  ASSERT_EQ(points.size(), 2U);
  for (const auto& [point, path] : {std::pair(points[0], first), std::pair(points[1], second)}) {
    const std::string name = fs::path(path).stem().string();
    const std::size_t x = point.find(": ");
    const std::size_t y = point.find("; ");
    ASSERT_NE(y, std::string::npos) << point;
    EXPECT_EQ(point.substr(0, x), name);
    EXPECT_NEAR(std::stod(point.substr(x + 2)), millions_in(path), 6e-4);
    expect_shown(point.substr(y + 2), evaluated(path)[name][4], "d1");
  }
  EXPECT_EQ(all(chart, "class=\"mark s1" + title).size(), 8U) << "published";
}

TEST_F(Report, ShowsPicturesBesideTheirDepthAndEachModels) {
  const std::string page =
      report({model("first", EncoderKind::kXxs), model("second", EncoderKind::kXs)});
  const std::string gallery = page.substr(page.find("<h2>Pictures</h2>"));
  Texts captions;
  for (int i = kPictures - 4; i < kPictures; ++i) {
    captions.push_back("pack " + std::to_string(100 + i) + ": picture, truth, first, second");
  }
  EXPECT_EQ(all(gallery, "<figcaption>([^<]*)<"), captions);
  EXPECT_EQ(all(gallery, "<img width=\"([0-9]*)\" height=\"48\""), Texts(4, "256"));
}

TEST_F(Report, ReadsWhatATrainingWrote) {
  const std::string training = folder_.file("training");
  run({"train", "--encoder", "xxs", "--stage", "0.2:2:1", "--workers", "1", "--head-from", "0",
       "--steps", "2", "--validate-every", "1", "--output", training});
  const std::string page =
      report({model("small", EncoderKind::kXxs)},
             {"--curve", training + "/curve.csv", "--validation", training + "/validation.csv"});
  EXPECT_NE(chart_in(page, "Training losses").find("distillation</span>"), std::string::npos);
  for (const char* title : {"Validation: AbsRel beside a constant depth&#39;s", "Validation: d1"}) {
    const std::string chart = chart_in(page, title);
    EXPECT_NE(chart.find("pack</span>"), std::string::npos) << title;
    EXPECT_EQ(marks(chart, 0).size(), 2U) << title;
  }
}

// The third of hall's values is three quarters of the way from the first to the second, and of a
// run that begins behind the first one's 100 steps.
TEST_F(Report, DrawsALineForEachSetThatWasValidatedOn) {
  const std::string csv = folder_.write("validation.csv",
                                        "step,set,abs_rel,d1,constant\n"
                                        "50,hall,0.40,0.1,0.4\n50,attic,0.3,0.5,0.3\n"
                                        "100,hall,0.20,0.5,0.4\n100,attic,0.3,0.6,0.3\n"
                                        "50,hall,0.05,0.4,0.08\n");
  const std::string page = report({model("small", EncoderKind::kXxs)}, {"--validation", csv});
  EXPECT_EQ(page.find("Training losses"), std::string::npos);
  const std::string d1 = chart_in(page, "Validation: d1");
  EXPECT_EQ(all(d1, "</svg>([a-z]+)</span>"), (Texts{"attic", "hall"}));
  EXPECT_EQ(marks(d1, 0).size(), 2U);
  const std::string share = chart_in(page, "Validation: AbsRel beside a constant depth&#39;s");
  for (const std::string& chart : {d1, share}) {
    const std::vector<cv::Point2d> hall = marks(chart, 1);
    ASSERT_EQ(hall.size(), 3U);
    EXPECT_NEAR((hall[2].x - hall[0].x) / (hall[1].x - hall[0].x), 2, 0.01);
    EXPECT_NEAR((hall[2].y - hall[0].y) / (hall[1].y - hall[0].y), 0.75, 0.01);
  }
}

}  // namespace
}  // namespace lcdm::model
