// lcdm-train report: models side by side on one page, as the paper's tables have them.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <map>
#include <set>

#include "firmware/nn/engine.h"
#include "model/commands.h"
#include "model/csv.h"
#include "model/data_sets.h"
#include "model/evaluation.h"
#include "model/html_page.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kPictures = 4;  // of each set
constexpr int kTimedFrames = 30;

struct Options {
  DataOptions data;
  std::vector<std::string> models;
  std::string curve;
  std::string validation;
  std::string output = "build/report.html";
  bool test = false;
};

// On KITTI's Eigen split at 640x192, from the projects' own pages; to compare with only where the
// models of this page were measured on that split.
struct Published {
  const char* name;
  double parameters;  // millions
  double abs_rel;
  double delta1;
};
constexpr Published kPublished[] = {
    {"Monodepth2-R18", 14.3, .115, .877}, {"R-MSFM6", 3.8, .112, .878},
    {"Lite-Mono-tiny", 2.2, .110, .880},  {"Lite-Mono", 3.1, .107, .886},
    {"MViTDepth-small", 2.8, .107, .883}, {"MViTDepth", 6.3, .106, .891},
    {"Lite-Mono-8M", 8.7, .101, .897},    {"MonoViT", 27, .099, .900},
};

struct Candidate {
  std::string name;
  Estimator estimator;
  double parameters = 0;  // millions; 0: none
};

// Millions. Of the file: layers of several sampling steps share theirs.
double parameters_of(const ModelFile& file) {
  double count = 0;
  for (const auto& [name, tensor] : file.tensors()) {
    double size = 1;
    for (const std::int64_t extent : tensor.shape) size *= static_cast<double>(extent);
    count += size;
  }
  return count * 1e-6;
}

// Median milliseconds of the engine on one thread; NaN where it cannot run.
double milliseconds_of(Engine& engine, int width, int height) {
  const std::vector<float> image(static_cast<std::size_t>(width * height) * 3, 0.5F);
  std::vector<double> times;
  for (int i = 0; i < kTimedFrames; ++i) {
    const auto begin = std::chrono::steady_clock::now();
    if (!engine.run_network(image)) return std::nan("");
    times.push_back(
        std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin)
            .count());
  }
  std::sort(times.begin(), times.end());
  return times[times.size() / 2];
}

// One row: what a model costs at one input size.
Result<std::vector<std::string>> cost_of(const std::string& name, const ModelFile& file, int width,
                                         int height) {
  EngineOptions wanted;
  wanted.width = width;
  wanted.height = height;
  wanted.threads = 1;
  auto engine = Engine::prepare(file, wanted, {PixelFormat::kRgb24, width, height, width * 3},
                                CameraModel::from_field_of_view(width, height, 65));
  if (!engine) return engine.status();
  const EngineStats stats = (*engine)->stats();
  return std::vector<std::string>{name,
                                  std::to_string(width) + "x" + std::to_string(height),
                                  number_text(parameters_of(file), 3),
                                  number_text(static_cast<double>(stats.macs) * 1e-9, 3),
                                  number_text(static_cast<double>(stats.arena_bytes) * 1e-6, 4),
                                  number_text(milliseconds_of(**engine, width, height), 3)};
}

Status add_costs(HtmlPage& page, const Options& options) {
  std::vector<std::vector<std::string>> rows;
  for (const std::string& path : options.models) {
    const Result<ModelFile> file = ModelFile::load(path);
    if (!file) return file.status();
    for (const auto& [width, height] : file->config().trained_sizes) {
      const cv::Size size = deployed_size(file->config(), {width, height});
      const auto row = cost_of(fs::path(path).stem().string(), *file, size.width, size.height);
      if (!row) return row.status();
      rows.push_back(*row);
    }
  }
  page.heading("Cost");
  page.table({"model", "input", "parameters, M", "GMAC", "arena, MB", "engine, ms"}, rows);
  page.note("The engine on one thread of this machine, median of " + std::to_string(kTimedFrames) +
            " frames.");
  return Status::ok();
}

void add_accuracy(HtmlPage& page, const Pack& pack, const Protocol& protocol,
                  const std::vector<Candidate>& candidates, Chart& accuracy) {
  SetResult first;
  std::vector<std::vector<std::string>> rows;
  std::vector<std::string> missing;
  Series series;
  series.name = pack.use.name;
  for (const Candidate& candidate : candidates) {
    const SetResult result = evaluate(*pack.frames, pack.validation, protocol, candidate.estimator);
    if (result.missing > 0) {
      missing.push_back(candidate.name + ": " + std::to_string(result.missing) +
                        " frames could not be measured; the last: " + result.why_missing.text());
    }
    const bool is_first = &candidate == &candidates.front();
    if (is_first) first = result;
    if (result.frames.empty()) continue;
    const Metrics& m = result.mean;
    std::vector<std::string> row = {candidate.name, std::to_string(result.frames.size())};
    for (const double value :
         {m.abs_rel, m.sq_rel, m.rmse, m.rmse_log, m.delta1, m.delta2, m.delta3}) {
      row.push_back(number_text(value, 3));
    }
    if (is_first || first.frames.empty()) {
      row.push_back("");
    } else {
      const Difference d = paired_difference(result, first, &Metrics::abs_rel);
      row.push_back(number_text(d.mean, 2) + " [" + number_text(d.low, 2) + ", " +
                    number_text(d.high, 2) + "]");
    }
    rows.push_back(row);
    if (candidate.parameters == 0) continue;
    series.x.push_back(candidate.parameters);
    series.y.push_back(m.delta1);
    series.labels.push_back(candidate.name);
  }
  page.table({pack.use.name, "frames", "AbsRel", "SqRel", "RMSE", "RMSElog", "d1", "d2", "d3",
              "difference [95 %]"},
             rows);
  for (const std::string& note : missing) page.note(note);
  if (!series.x.empty()) accuracy.series.push_back(series);
}

std::vector<Picture> pictures_of(const Pack& pack, const std::vector<Candidate>& candidates) {
  std::vector<Picture> pictures;
  const std::size_t stride = std::max<std::size_t>(1, pack.validation.size() / kPictures);
  for (std::size_t i = 0; i < pack.validation.size() && pictures.size() < kPictures; i += stride) {
    const Result<PackFrame> frame = pack.frames->read(pack.validation[i]);
    if (!frame) continue;
    std::string caption = pack.use.name + " " + frame->name + ": picture, truth";
    std::vector<cv::Mat> estimates;
    for (const Candidate& candidate : candidates) {
      const cv::Mat estimate = candidate.parameters > 0 ? candidate.estimator(*frame) : cv::Mat();
      if (estimate.empty()) continue;
      estimates.push_back(estimate);
      caption += ", " + candidate.name;
    }
    pictures.push_back({comparison_picture(*frame, estimates), caption});
  }
  return pictures;
}

// Several runs' steps one behind the other: where the number falls a new run begins.
std::vector<double> joined(std::vector<double> steps) {
  double before = 0;
  double last = 0;
  for (double& step : steps) {
    if (step < last) before += last;
    last = step;
    step += before;
  }
  return steps;
}

Status add_curve(HtmlPage& page, const std::string& path) {
  const Result<CsvTable> table = read_csv(path);
  if (!table) return table.status();
  const auto steps = table->numbers("step");
  if (!steps) return steps.status();
  Chart chart;
  chart.title = "Training losses";
  chart.x_label = "step";
  chart.y_label = "loss";
  chart.log_y = true;
  for (const std::string& name : table->header) {
    static const std::set<std::string> others = {"run", "step", "images", "seconds",
                                                 "learning_rate"};
    if (others.count(name) > 0) continue;
    const auto values = table->numbers(name);
    if (!values) return values.status();
    if (std::any_of(values->begin(), values->end(), [](double v) { return v > 0; })) {
      chart.series.push_back({name, joined(*steps), *values});
    }
  }
  page.line_chart(chart);
  return Status::ok();
}

// A line for each set that was validated on; `sets`, `steps` and `values` are of the same rows.
Chart validation_chart(const std::string& title, const std::vector<std::string>& sets,
                       const std::vector<double>& steps, const std::vector<double>& values) {
  Chart chart;
  chart.title = title;
  chart.x_label = "step";
  std::map<std::string, Series> series;
  for (std::size_t i = 0; i < sets.size(); ++i) {
    Series& of_set = series[sets[i]];
    of_set.name = sets[i];
    of_set.x.push_back(steps[i]);
    of_set.y.push_back(values[i]);
  }
  for (const auto& [name, of_set] : series) chart.series.push_back(of_set);
  return chart;
}

Status add_validation(HtmlPage& page, const std::string& path) {
  const Result<CsvTable> table = read_csv(path);
  if (!table) return table.status();
  const auto sets = table->texts("set");
  if (!sets) return sets.status();
  std::map<std::string, std::vector<double>> columns;
  for (const char* name : {"step", "abs_rel", "d1", "constant"}) {
    const auto numbers = table->numbers(name);
    if (!numbers) return numbers.status();
    columns[name] = *numbers;
  }
  std::vector<double> shares = columns["abs_rel"];
  for (std::size_t i = 0; i < shares.size(); ++i) shares[i] /= columns["constant"][i];
  const std::vector<double> steps = joined(columns["step"]);
  Chart chart =
      validation_chart("Validation: AbsRel beside a constant depth's", *sets, steps, shares);
  chart.y_label = "share of a constant depth's AbsRel";
  page.line_chart(chart);
  chart = validation_chart("Validation: d1", *sets, steps, columns["d1"]);
  chart.y_label = "d1";
  page.line_chart(chart);
  return Status::ok();
}

// What a training wrote, where it is named.
Status add_training(HtmlPage& page, const Options& options) {
  if (options.curve.empty() && options.validation.empty()) return Status::ok();
  page.heading("Training");
  if (!options.curve.empty()) LCDM_RETURN_IF_ERROR(add_curve(page, options.curve));
  if (!options.validation.empty()) LCDM_RETURN_IF_ERROR(add_validation(page, options.validation));
  return Status::ok();
}

void add_published(Chart& accuracy) {
  Series series;
  series.name = "published, KITTI Eigen";
  for (const Published& p : kPublished) {
    series.x.push_back(p.parameters);
    series.y.push_back(p.delta1);
    series.labels.push_back(p.name);
  }
  accuracy.series.push_back(series);
}

Result<std::vector<Candidate>> candidates_of(const Options& options) {
  std::vector<Candidate> candidates;
  for (const std::string& path : options.models) {
    const Result<Estimator> estimator = file_estimator(path);
    if (!estimator) return estimator.status();
    candidates.push_back(
        {fs::path(path).stem().string(), *estimator, parameters_of(*ModelFile::load(path))});
  }
  candidates.push_back({"constant", constant_estimator()});
  return candidates;
}

Status run(const Options& options) {
  const auto candidates = candidates_of(options);
  if (!candidates) return candidates.status();
  const Result<Data> data =
      options.test ? load_test_data(options.data) : load_training_data(options.data);
  if (!data) return data.status();
  LCDM_RETURN_IF_ERROR(require_frames(*data, options.test));
  HtmlPage page("Depth networks compared");
  LCDM_RETURN_IF_ERROR(add_costs(page, options));
  page.heading(options.test ? "Accuracy on the test sets" : "Accuracy on the validation parts");
  page.paragraph(
      "Median-scaled. The difference is AbsRel's to the first row, with its interval by the paired "
      "bootstrap over frames and "
      "over runs of them, the wider.");
  Chart accuracy;
  accuracy.title = "Parameters against d1";
  accuracy.x_label = "parameters, millions";
  accuracy.y_label = "d1";
  accuracy.log_x = true;
  std::vector<Picture> pictures;
  for (std::size_t i = 0; i < data->packs.size(); ++i) {
    const Pack& pack = data->packs[i];
    if (pack.validation.empty()) continue;
    std::vector<Candidate> of_pack = *candidates;
    if (const fs::path maps = maps_beside_depth(pack); !maps.empty()) {
      of_pack.push_back({"teacher " + pack.use.maps, maps_estimator(maps.string())});
    }
    add_accuracy(page, pack, data->protocols[i], of_pack, accuracy);
    const std::vector<Picture> of_set = pictures_of(pack, *candidates);
    pictures.insert(pictures.end(), of_set.begin(), of_set.end());
  }
  add_published(accuracy);
  page.scatter_chart(accuracy);
  page.note(
      "Points of different sets are not comparable with each other: published figures are of "
      "KITTI's Eigen split, ours of the sets named.");
  LCDM_RETURN_IF_ERROR(add_training(page, options));
  page.heading("Pictures");
  page.gallery(pictures);
  LCDM_RETURN_IF_ERROR(page.write(options.output));
  std::printf("%s\n", options.output.c_str());
  return Status::ok();
}

}  // namespace

void add_report(CLI::App& app, Status& status) {
  auto* command = app.add_subcommand(
      "report", "Cost, accuracy and pictures of models side by side, as one HTML page");
  auto options = std::make_shared<Options>();
  add_data_options(*command, options->data);
  command->add_option("--model", options->models, "Exported model file; may be given again")
      ->check(CLI::ExistingFile)
      ->required();
  command->add_option("--curve", options->curve, "curve.csv of a training")
      ->check(CLI::ExistingFile);
  command->add_option("--validation", options->validation, "validation.csv of a training")
      ->check(CLI::ExistingFile);
  add_test_option(*command, options->test);
  command->add_option("--output", options->output, "The page")->capture_default_str();
  command->callback([options, &status] { status = run(*options); });
}

}  // namespace lcdm::model
