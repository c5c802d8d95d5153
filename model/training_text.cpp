#include "model/training_text.h"

#include <algorithm>
#include <cstdio>
#include <sstream>

namespace lcdm::model {
namespace {

std::string text_of(const Pack& pack) {
  const PackUse& use = pack.use;
  char numbers[160];
  std::snprintf(numbers, sizeof(numbers),
                ", teacher %d, alignment %d, trust %g, shares %g and %g, things %g, view %g",
                static_cast<int>(use.teacher), static_cast<int>(use.alignment),
                static_cast<double>(use.weight), static_cast<double>(use.wide_share),
                static_cast<double>(use.tall_share), static_cast<double>(use.things),
                static_cast<double>(use.field_of_view));
  return "trains on " + std::to_string(pack.train.size()) + " frames of " + use.name + numbers +
         (use.teacher == Teacher::kMaps ? ", maps " + use.maps : "") +
         (use.video ? ", video" : "") + (use.learn_intrinsics ? ", learned intrinsics" : "") + "\n";
}

std::vector<std::string> lines_of(const std::string& one_line) {
  std::vector<std::string> lines;
  std::istringstream stream(one_line);
  for (std::string line; std::getline(stream, line, ';');) lines.push_back(line);
  return lines;
}

}  // namespace

std::string training_text(const Recipe& recipe, const std::vector<Pack>& packs) {
  std::string text = recipe_text(recipe);
  int photographs = 0;
  for (const Pack& pack : packs) {
    text += text_of(pack);
    photographs = std::max(photographs, pack.use.photographs);
  }
  return text + "medleys painted with " + std::to_string(photographs) + " photographs\n";
}

std::string on_one_line(std::string text) {
  for (char& c : text) {
    if (c == '\n') c = ';';
    if (c < ' ' || c > '~') c = '?';  // of a folder's name
  }
  return text;
}

std::string changed_lines(const std::string& then, const std::string& now) {
  const std::vector<std::string> before = lines_of(then);
  const std::vector<std::string> after = lines_of(now);
  std::string changed;
  const auto note = [&](const char* when, const std::vector<std::string>& lines,
                        const std::vector<std::string>& others) {
    for (const std::string& line : lines) {
      const bool known = std::find(others.begin(), others.end(), line) != others.end();
      if (!known) changed += when + line + "\n";
    }
  };
  note("  then: ", before, after);
  note("  now:  ", after, before);
  return changed;
}

}  // namespace lcdm::model
