#include "model/catalogue.h"

#include <filesystem>
#include <toml.hpp>

#include "drivers/scene/textures.h"
#include "model/scene_pack.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;
using Form = CatalogueEntry::Form;

// One table of the file. Every value is asked for once; what is left over is a mistake.
class Table {
 public:
  Table(std::string file, const toml::value& value) : file_(std::move(file)), value_(value) {
    if (value.is_table()) left_ = value.as_table();
  }

  // Leaves `out` alone where the key is missing; what is of the wrong type is told by finish().
  void take(const char* key, std::string& out) {
    take_value(key, "a text in quotes", [&out](const toml::value& v) {
      if (v.is_string()) out = v.as_string().str;
      return v.is_string();
    });
  }
  void take(const char* key, bool& out) {
    take_value(key, "true or false", [&out](const toml::value& v) {
      if (v.is_boolean()) out = v.as_boolean();
      return v.is_boolean();
    });
  }
  // Not negative.
  void take(const char* key, float& out) {
    take_value(key, "a number, 0 or more", [&out](const toml::value& v) {
      if (!v.is_floating() && !v.is_integer()) return false;
      const double number = v.is_floating() ? v.as_floating() : static_cast<double>(v.as_integer());
      if (!(number >= 0 && number < 1e9)) return false;
      out = static_cast<float>(number);
      return true;
    });
  }
  template <typename Enum>
  void take(const char* key, const std::map<std::string, Enum>& names, Enum& out) {
    std::string all;
    for (const auto& item : names) all += (all.empty() ? "" : ", ") + item.first;
    take_value(key, ("one of " + all).c_str(), [&](const toml::value& v) {
      const auto found = v.is_string() ? names.find(v.as_string().str) : names.end();
      if (found != names.end()) out = found->second;
      return found != names.end();
    });
  }

  Status fault(const std::string& text) const {
    return Status::error(StatusCode::kInvalidInput, "%s:%u: %s", file_.c_str(),
                         static_cast<unsigned>(value_.location().line()), text.c_str());
  }
  // The first fault found, or the first key that nobody asked for.
  Status finish() const {
    if (!error_) return error_;
    if (left_.empty()) return Status::ok();
    return fault("no key \"" + left_.begin()->first + "\" here: see model/data/README.md");
  }

 private:
  template <typename Read>
  void take_value(const char* key, const char* wanted, const Read& read) {
    const auto found = left_.find(key);
    if (found == left_.end()) return;
    if (error_ && !read(found->second)) error_ = fault(std::string(key) + " must be " + wanted);
    left_.erase(key);
  }

  std::string file_;
  const toml::value& value_;
  toml::table left_;
  Status error_;
};

// The keys that a form would ignore.
std::vector<std::string> idle_keys(Form form) {
  switch (form) {
    case Form::kPack:
      return {"list", "validation-list", "ground-truth"};
    case Form::kKittiRaw:
      return {"video"};  // it always is
    default:             // depth and cameras are the set's own, pictures single
      return {"list", "validation-list", "ground-truth",  "teacher",
              "maps", "align",           "field-of-view", "video"};
  }
}

Result<CatalogueEntry> read_entry(const std::string& file, const toml::value& value, bool trains) {
  static const std::map<std::string, Form> forms = {{"pack", Form::kPack},
                                                    {"kitti-raw", Form::kKittiRaw},
                                                    {"nyu", Form::kNyu},
                                                    {"make3d", Form::kMake3d}};
  static const std::map<std::string, Teacher> teachers = {
      {"sensor", Teacher::kSensor}, {"maps", Teacher::kMaps}, {"none", Teacher::kNone}};
  CatalogueEntry entry;
  PackUse& use = entry.use;
  std::string protocol = "indoor";
  Table table(file, value);
  table.take("form", forms, entry.form);
  table.take("path", entry.path);
  table.take("teacher", teachers, use.teacher);
  table.take("maps", use.maps);
  table.take("align", alignment_names(), use.alignment);
  table.take("field-of-view", use.field_of_view);
  table.take("learn-intrinsics", use.learn_intrinsics);
  table.take("trust", use.weight);
  table.take("wide-share", use.wide_share);
  table.take("tall-share", use.tall_share);
  table.take("things", use.things);
  table.take("video", use.video);
  table.take("protocol", protocol);
  table.take("list", entry.list);
  table.take("validation-list", entry.validation_list);
  table.take("ground-truth", entry.ground_truth);
  LCDM_RETURN_IF_ERROR(table.finish());
  if (entry.path.empty()) return table.fault("the entry has no path");
  for (const std::string& key : idle_keys(entry.form)) {
    if (value.contains(key)) {
      return table.fault("\"" + key + "\" says nothing to this form: leave it out");
    }
  }
  entry.says_align = value.contains("align");
  const Result<Protocol> found = protocol_named(protocol);
  if (!found) return table.fault(found.status().text());
  entry.protocol = *found;
  if (trains && entry.form == Form::kKittiRaw && entry.validation_list.empty()) {
    return table.fault(
        "kitti-raw trains with a validation-list only: no part of one shuffled list is without "
        "neighbours in the other");
  }
  use.name = entry.path;
  return entry;
}

Status read_entries(const std::string& file, const toml::value& root, bool trains,
                    std::vector<CatalogueEntry>& entries) {
  const char* key = trains ? "train" : "test";
  if (!root.contains(key)) return Status::ok();
  const toml::value& list = root.at(key);
  if (!list.is_array()) {
    return Status::error(StatusCode::kInvalidInput, "%s: write [[%s]] before each entry",
                         file.c_str(), key);
  }
  for (const toml::value& value : list.as_array()) {
    Result<CatalogueEntry> entry = read_entry(file, value, trains);
    if (!entry) return entry.status();
    if (trains && !value.contains("wide-share") && !value.contains("tall-share")) {
      return Table(file, value)
          .fault("no wide-share or tall-share: it would never be drawn (0 if that is meant)");
    }
    entries.push_back(std::move(*entry));
  }
  return Status::ok();
}

Status read_rendered(const std::string& file, const toml::value& root, Rendering rendering,
                     RenderedUse& use) {
  const char* key = rendering == Rendering::kMedley ? "medley" : "scene";
  if (!root.contains(key)) return Status::ok();
  float frames = 0;
  float photographs = 0;
  Table table(file, root.at(key));
  table.take("frames", frames);
  table.take("wide-share", use.wide_share);
  table.take("tall-share", use.tall_share);
  if (rendering == Rendering::kMedley) table.take("photographs", photographs);
  LCDM_RETURN_IF_ERROR(table.finish());
  if (photographs > scene::kMostPhotographs) {
    return table.fault("\"photographs\" is at most " + std::to_string(scene::kMostPhotographs));
  }
  use.photographs = static_cast<int>(photographs);
  use.frames = static_cast<std::size_t>(frames);
  if (use.frames <= kMostRenderedFrames) return Status::ok();
  return table.fault("\"frames\" is at most " + std::to_string(kMostRenderedFrames) +
                     ": more would show the worlds that validate");
}

Result<Catalogue> catalogue_of(const std::string& file, const toml::value& root) {
  Catalogue catalogue;
  LCDM_RETURN_IF_ERROR(read_entries(file, root, true, catalogue.train));
  LCDM_RETURN_IF_ERROR(read_entries(file, root, false, catalogue.test));
  LCDM_RETURN_IF_ERROR(read_rendered(file, root, Rendering::kScene, catalogue.scene));
  LCDM_RETURN_IF_ERROR(read_rendered(file, root, Rendering::kMedley, catalogue.medley));
  toml::value rest = root;
  for (const char* key : {"train", "test", "scene", "medley"}) rest.as_table().erase(key);
  Table top(file, rest);
  top.take("licence", catalogue.licence);
  top.take("root", catalogue.root);
  LCDM_RETURN_IF_ERROR(top.finish());
  return catalogue;
}

}  // namespace

Result<Catalogue> read_catalogue(const std::string& file) {
  if (!fs::is_regular_file(file)) {
    return Status::error(StatusCode::kInvalidInput,
                         "%s: no such catalogue of data: name one with --data (model/data/)",
                         file.c_str());
  }
  try {
    return catalogue_of(file, toml::parse(file));
  } catch (const std::exception& error) {
    const std::string what = error.what();
    return Status::error(StatusCode::kInvalidInput, "%s: %s", file.c_str(),
                         what.substr(0, what.find('\n')).c_str());
  }
}

}  // namespace lcdm::model
