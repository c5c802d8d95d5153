// What a training run tells while it runs: a line on the terminal, curve.csv and validation.csv.
#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <filesystem>

#include "model/losses.h"
#include "model/trainer.h"
#include "model/validation.h"

namespace lcdm::model {

// Means of the losses since the last line, the rate and the time left: redrawn in place on a
// terminal, one line per `kStepsPerLine` otherwise, and one row of the curve.
class TrainingLog {
 public:
  static constexpr std::int64_t kStepsPerLine = 25;

  // Goes on with the folder's files, whose rows past step `first` are dropped, and from the time of
  // the last one that is kept; of `total` steps.
  TrainingLog(const std::filesystem::path& folder, std::int64_t first, std::int64_t total);
  ~TrainingLog();
  TrainingLog(const TrainingLog&) = delete;
  TrainingLog& operator=(const TrainingLog&) = delete;

  void add(const Trainer& trainer, const Losses& losses);
  void add(const Trainer& trainer, const Validation& validation, bool best);

 private:
  using Clock = std::chrono::steady_clock;
  void print(const Trainer& trainer);

  bool terminal_;
  std::int64_t first_;
  std::int64_t total_;
  Clock::time_point start_ = Clock::now();
  double seconds_before_ = 0;  // of the curve's rows that are kept
  std::FILE* curve_;
  std::FILE* validation_;
  std::array<double, kTermNames.size()> sums_{};
  int count_ = 0;
};

}  // namespace lcdm::model
