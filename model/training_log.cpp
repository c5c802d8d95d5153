#include "model/training_log.h"

#include <cstdlib>
#include <fstream>
#include <sstream>
#include <string>
#include <string_view>
#include <unistd.h>

#include "firmware/base/file.h"
#include "model/csv.h"

namespace lcdm::model {
namespace {

// The file's lines up to step `last`, whole ones only: a crash may have cut the last line, and what
// came after the checkpoint is done again. Empty without a file.
std::string rows_until(const std::filesystem::path& path, std::int64_t last) {
  std::ostringstream file;
  file << std::ifstream(path).rdbuf();  // a folder throws nothing here
  const std::string text = file.str();
  std::string kept;
  std::string_view rest = text;
  for (std::string_view line = rest; const auto cells = take_csv_line(rest); line = rest) {
    line.remove_suffix(rest.size());
    const bool header = kept.empty();
    if (header || std::atoll(cells->front().c_str()) <= last) kept += line;
  }
  return kept;
}

// When the last row of the curve was written; 0 where there is none.
double seconds_until(const std::filesystem::path& path) {
  const Result<CsvTable> curve = read_csv(path.string());
  const auto seconds = curve ? curve->numbers("seconds") : curve.status();
  return seconds && !seconds->empty() ? seconds->back() : 0;
}

// Null where it cannot be written: a training goes on without its log, and a full disk costs
// nothing of what is there.
std::FILE* open_to_append(const std::filesystem::path& path, std::int64_t last,
                          const std::string& header) {
  const std::string kept = rows_until(path, last);
  const Status replaced = replace_file(path.string(), kept.empty() ? header + "\n" : kept);
  if (!replaced) std::fprintf(stderr, "trains on without its log: %s\n", replaced.text());
  return replaced ? std::fopen(path.c_str(), "a") : nullptr;
}

}  // namespace

TrainingLog::TrainingLog(const std::filesystem::path& folder, std::int64_t first,
                         std::int64_t total)
    : terminal_(isatty(STDOUT_FILENO) != 0), first_(first), total_(total) {
  std::string header = "step,images,seconds,learning_rate";
  for (const char* name : kTermNames) header += std::string(",") + name;
  curve_ = open_to_append(folder / "curve.csv", first, header);
  seconds_before_ = seconds_until(folder / "curve.csv");
  validation_ = open_to_append(folder / "validation.csv", first, "step,set,abs_rel,d1,constant");
}

TrainingLog::~TrainingLog() {
  if (curve_ != nullptr) std::fclose(curve_);
  if (validation_ != nullptr) std::fclose(validation_);
  if (terminal_) std::printf("\n");
}

void TrainingLog::add(const Trainer& trainer, const Losses& losses) {
  for (std::size_t i = 0; i < sums_.size(); ++i) sums_[i] += losses.terms[i];
  ++count_;
  if (trainer.step() % kStepsPerLine != 0 && !trainer.done()) return;
  print(trainer);
  sums_ = {};
  count_ = 0;
}

void TrainingLog::print(const Trainer& trainer) {
  const double seconds = std::chrono::duration<double>(Clock::now() - start_).count();
  const double per_step = seconds / static_cast<double>(trainer.step() - first_);
  const double left = per_step * static_cast<double>(total_ - trainer.step());
  const double n = static_cast<double>(count_);
  std::printf("%s%lld/%lld  %.2f s/step  %.0f min left", terminal_ ? "\r" : "",
              static_cast<long long>(trainer.step()), static_cast<long long>(total_), per_step,
              left / 60);
  for (std::size_t i = 0; i < sums_.size(); ++i) {
    if (sums_[i] != 0) std::printf("  %s %.4f", kTermNames[i], sums_[i] / n);
  }
  std::printf("%s", terminal_ ? "  " : "\n");
  std::fflush(stdout);
  if (curve_ == nullptr) return;
  std::fprintf(curve_, "%lld,%lld,%.1f,%.3g", static_cast<long long>(trainer.step()),
               static_cast<long long>(trainer.images()), seconds_before_ + seconds,
               trainer.learning_rate());
  for (const double sum : sums_) std::fprintf(curve_, ",%.5f", sum / n);
  std::fprintf(curve_, "\n");
  std::fflush(curve_);
}

void TrainingLog::add(const Trainer& trainer, const Validation& validation, bool best) {
  const auto step = static_cast<long long>(trainer.step());
  std::printf("%svalidation at step %lld: %.3f of a constant depth's AbsRel%s\n",
              terminal_ ? "\n" : "", step, validation.score, best ? ", the best so far" : "");
  for (const Validation::Set& set : validation.sets) {
    std::printf("  %s: AbsRel %.3f, d1 %.3f (constant %.3f)\n", set.name.c_str(),
                set.network.abs_rel, set.network.delta1, set.constant.abs_rel);
    if (validation_ == nullptr) continue;
    std::fprintf(validation_, "%lld,%s,%.5f,%.5f,%.5f\n", step, csv_cell(set.name).c_str(),
                 set.network.abs_rel, set.network.delta1, set.constant.abs_rel);
  }
  std::fflush(stdout);
  if (validation_ != nullptr) std::fflush(validation_);
}

}  // namespace lcdm::model
