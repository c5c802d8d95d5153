#include "model/recipe.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <sstream>

namespace lcdm::model {
namespace {

// From where to where the learning rate runs one course, and how high it starts.
struct Course {
  std::int64_t first = 0;
  std::int64_t end = 0;
  double learning_rate = 0;
};

Course course_at(const Recipe& recipe, std::int64_t step) {
  Course course{0, recipe.steps, recipe.learning_rate};
  std::int64_t begin = 0;
  for (const Stage& stage : recipe.stages) {
    if (stage.learning_rate > 0 && begin > step) {
      course.end = begin;
      break;
    }
    if (stage.learning_rate > 0) {
      course.first = begin;
      course.learning_rate = stage.learning_rate;
    }
    begin = first_step(recipe, stage.until);
  }
  return course;
}

double rate_on(const Course& course, const Recipe& recipe, std::int64_t at) {
  const auto step = static_cast<double>(at - course.first);
  const auto warm_up = static_cast<double>(recipe.warm_up);
  if (step < warm_up) return course.learning_rate * (step + 1) / warm_up;
  const double all = static_cast<double>(course.end - course.first) - warm_up;
  const double progress = std::min(1.0, (step - warm_up) / std::max(1.0, all));
  return recipe.final_rate +
         (course.learning_rate - recipe.final_rate) * 0.5 * (1 + std::cos(M_PI * progress));
}

}  // namespace

Result<Stage> parse_stage(const std::string& text) {
  Stage stage;
  int used = 0, used_with_rate = 0;
  const int fields = std::sscanf(text.c_str(), "%lf:%d:%lf%n:%lf%n", &stage.share, &stage.images,
                                 &stage.until, &used, &stage.learning_rate, &used_with_rate);
  const bool whole = fields == 4   ? text.size() == static_cast<std::size_t>(used_with_rate)
                     : fields == 3 ? text.size() == static_cast<std::size_t>(used)
                                   : false;
  if (!whole || !(stage.share >= 0.2 && stage.share <= 2) || stage.images < 1 ||
      !(stage.until > 0 && stage.until <= 1) ||
      (fields == 4 && !(stage.learning_rate > 0 && stage.learning_rate < 1))) {
    return Status::error(StatusCode::kUsage,
                         "stage \"%s\" is not SHARE:IMAGES:UNTIL or SHARE:IMAGES:UNTIL:RATE, such "
                         "as 0.5:8:0.8 (size 0.2 to 2 of the deployed one, until 0 to 1 of the "
                         "steps, learning rate below 1)",
                         text.c_str());
  }
  return stage;
}

std::string recipe_text(const Recipe& recipe) {
  std::ostringstream text;
  text.precision(17);
  const auto line = [&text](const char* name, const auto& value) {
    text << name << " = " << value << '\n';
  };
  line("encoder", static_cast<int>(recipe.encoder));
  line("preset", static_cast<int>(recipe.preset));
  line("start", static_cast<int>(recipe.start.value_or(StartKind::kNoise)));
  line("seed", recipe.seed);
  line("steps", recipe.steps);
  for (const Stage& stage : recipe.stages) {
    text << "stage = " << stage.share << ':' << stage.images << ':' << stage.until << ':'
         << stage.learning_rate << '\n';
  }
  line("head-from", recipe.head_from);
  line("freeze-from", recipe.freeze_from);
  line("accumulate", recipe.accumulate);
  line("workers", recipe.workers);
  line("bf16", recipe.bf16);
  if (recipe.optimizer != OptimizerKind::kAdamW) {  // folders of before know no other
    line("optimizer", static_cast<int>(recipe.optimizer));
  }
  line("learning-rate", recipe.learning_rate);
  line("final-rate", recipe.final_rate);
  line("warm-up", recipe.warm_up);
  line("weight-decay", recipe.weight_decay);
  line("clip", recipe.clip);
  line("average", recipe.average);
  line("distillation", recipe.losses.distillation);
  line("denoising", recipe.losses.denoising);
  line("normals", recipe.losses.normals);
  line("photometric", recipe.losses.photometric);
  line("smoothness", recipe.losses.smoothness);
  line("gradient", recipe.losses.gradient);
  line("direct", recipe.losses.direct);
  return text.str();
}

int scaled_side(int side, double share) {
  return std::max(64, static_cast<int>(std::lround(side * share / 32)) * 32);
}

std::int64_t first_step(const Recipe& recipe, double share) {
  return static_cast<std::int64_t>(std::ceil(share * static_cast<double>(recipe.steps)));
}

std::size_t stage_at(const Recipe& recipe, std::int64_t step) {
  std::size_t index = 0;
  while (index + 1 < recipe.stages.size() &&
         step >= first_step(recipe, recipe.stages[index].until)) {
    ++index;
  }
  return index;
}

double learning_rate_at(const Recipe& recipe, std::int64_t step) {
  return rate_on(course_at(recipe, step), recipe, step);
}

double head_rate_at(const Recipe& recipe, std::int64_t step) {
  Course course = course_at(recipe, step);
  course.first = std::max(course.first, first_step(recipe, recipe.head_from));
  return rate_on(course, recipe, step);
}

ModelConfig model_config_of(const Recipe& recipe) {
  ModelConfig config;
  config.encoder = recipe.encoder;
  config.preset = recipe.preset;
  config.start = recipe.start.value_or(StartKind::kNoise);
  config.steps =
      recipe.preset == PresetKind::kLcdm ? std::vector<int>{149, 74} : std::vector<int>{75, 0};
  config.seed = 1;
  config.canonical_focal = kCanonicalFocal;
  config.trained_sizes = {{kDeployed[0][0], kDeployed[0][1]}, {kDeployed[1][0], kDeployed[1][1]}};
  return config;
}

}  // namespace lcdm::model
