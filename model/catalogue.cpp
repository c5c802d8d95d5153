#include "model/catalogue.h"

#include <numeric>
#include <toml.hpp>

#include "firmware/base/folder.h"
#include "firmware/nn/json.h"
#include "model/dataset_files.h"
#include "model/kitti_raw.h"
#include "model/make3d.h"
#include "model/nyu_depth.h"
#include "model/scene_pack.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;
using Form = CatalogueEntry::Form;

constexpr std::size_t kListedLast = 10;  // of a listed set without a split: every 10th validates

constexpr std::size_t kMostTeacherBytes = 1U << 12;  // of a teacher.json

enum class Purpose : std::uint8_t { kTrain, kTest };

// Wider pictures are reduced: never for a test.
int width_for(Purpose purpose) { return purpose == Purpose::kTrain ? 640 : kFullWidth; }

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

Result<CatalogueEntry> read_entry(const std::string& file, const toml::value& value) {
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
  table.take("video", use.video);
  table.take("protocol", protocol);
  table.take("list", entry.list);
  table.take("validation-list", entry.validation_list);
  table.take("ground-truth", entry.ground_truth);
  LCDM_RETURN_IF_ERROR(table.finish());
  if (entry.path.empty()) return table.fault("the entry has no path");
  const Result<Protocol> found = protocol_named(protocol);
  if (!found) return table.fault(found.status().text());
  entry.protocol = *found;
  if (!entry.validation_list.empty() && entry.form != Form::kKittiRaw) {
    return table.fault("only form = \"kitti-raw\" has a validation-list");
  }
  use.name = entry.path;
  return entry;
}

Status read_entries(const std::string& file, const toml::value& root, const char* key,
                    bool must_have_a_share, std::vector<CatalogueEntry>& entries) {
  if (!root.contains(key)) return Status::ok();
  const toml::value& list = root.at(key);
  if (!list.is_array()) {
    return Status::error(StatusCode::kInvalidInput, "%s: write [[%s]] before each entry",
                         file.c_str(), key);
  }
  for (const toml::value& value : list.as_array()) {
    Result<CatalogueEntry> entry = read_entry(file, value);
    if (!entry) return entry.status();
    if (must_have_a_share && !value.contains("wide-share") && !value.contains("tall-share")) {
      return Table(file, value)
          .fault("no wide-share or tall-share: it would never be drawn (0 if that is meant)");
    }
    entries.push_back(std::move(*entry));
  }
  return Status::ok();
}

Status read_rendered(const std::string& file, const toml::value& root, const char* key,
                     RenderedUse& use) {
  if (!root.contains(key)) return Status::ok();
  float frames = 0;
  Table table(file, root.at(key));
  table.take("frames", frames);
  table.take("wide-share", use.wide_share);
  table.take("tall-share", use.tall_share);
  LCDM_RETURN_IF_ERROR(table.finish());
  use.frames = static_cast<std::size_t>(frames);
  if (use.frames <= kMostRenderedFrames) return Status::ok();
  return table.fault("\"frames\" is at most " + std::to_string(kMostRenderedFrames) +
                     ": more would show the worlds that validate");
}

Result<Catalogue> catalogue_of(const std::string& file, const toml::value& root) {
  Catalogue catalogue;
  LCDM_RETURN_IF_ERROR(read_entries(file, root, "train", true, catalogue.train));
  LCDM_RETURN_IF_ERROR(read_entries(file, root, "test", false, catalogue.test));
  LCDM_RETURN_IF_ERROR(read_rendered(file, root, "scene", catalogue.scene));
  LCDM_RETURN_IF_ERROR(read_rendered(file, root, "medley", catalogue.medley));
  toml::value rest = root;
  for (const char* key : {"train", "test", "scene", "medley"}) rest.as_table().erase(key);
  Table top(file, rest);
  top.take("licence", catalogue.licence);
  top.take("root", catalogue.root);
  LCDM_RETURN_IF_ERROR(top.finish());
  return catalogue;
}

// A data set of one list has no split of its own.
Pack listed_pack(const CatalogueEntry& entry, std::shared_ptr<const Frames> frames) {
  Pack pack;
  pack.use = entry.use;
  pack.frames = std::move(frames);
  for (std::size_t i = 0; i < pack.frames->size(); ++i) {
    (i % kListedLast == kListedLast - 1 ? pack.validation : pack.train).push_back(i);
  }
  return pack;
}

// As published: all of the one list trains, the other validates.
Pack split_pack(const CatalogueEntry& entry, std::shared_ptr<const Frames> train,
                std::shared_ptr<const Frames> validation) {
  Pack pack;
  pack.use = entry.use;
  pack.train.resize(train->size());
  std::iota(pack.train.begin(), pack.train.end(), std::size_t{0});
  pack.validation.resize(validation->size());
  std::iota(pack.validation.begin(), pack.validation.end(), train->size());
  pack.frames = std::make_shared<JoinedFrames>(std::move(train), std::move(validation));
  return pack;
}

Result<std::shared_ptr<const Frames>> open_kitti(const CatalogueEntry& entry,
                                                 const std::string& list, const fs::path& root,
                                                 Purpose purpose) {
  if (entry.use.teacher == Teacher::kSensor && entry.ground_truth.empty()) {
    return Status::error(StatusCode::kInvalidInput,
                         "%s: say where depth comes from: ground-truth = \"velodyne\" or a folder, "
                         "teacher = \"maps\", or teacher = \"none\"",
                         entry.path.c_str());
  }
  KittiRawOptions options;
  options.root = (root / entry.path).string();
  options.list = (root / list).string();
  options.max_width = width_for(purpose);
  if (entry.use.teacher == Teacher::kMaps) {
    options.depth = KittiRawOptions::Depth::kMaps;
    options.depth_root = (root / entry.use.maps).string();
  } else if (entry.ground_truth == "velodyne") {
    options.depth = KittiRawOptions::Depth::kVelodyne;
  } else if (!entry.ground_truth.empty()) {
    options.depth = KittiRawOptions::Depth::kImproved;
    options.depth_root = (root / entry.ground_truth).string();
  }
  return open_kitti_raw(options);
}

Make3dOptions make3d_options(Purpose purpose) {
  Make3dOptions options;
  options.max_width = width_for(purpose);
  return options;
}

NyuDepthOptions nyu_options(Purpose purpose) {
  NyuDepthOptions options;
  options.max_width = width_for(purpose);
  options.split =
      purpose == Purpose::kTrain ? NyuDepthOptions::Split::kTrain : NyuDepthOptions::Split::kTest;
  return options;
}

Result<Pack> open_entry(const CatalogueEntry& entry, const fs::path& root, Purpose purpose,
                        std::size_t every) {
  if (entry.form == Form::kPack) {
    return load_pack(root, entry.use, width_for(purpose), every);
  }
  const auto frames = [&]() -> Result<std::shared_ptr<const Frames>> {
    if (entry.form == Form::kNyu)
      return open_nyu_depth((root / entry.path).string(), nyu_options(purpose));
    if (entry.form == Form::kMake3d)
      return open_make3d((root / entry.path).string(), make3d_options(purpose));
    return open_kitti(entry, entry.list, root, purpose);
  }();
  if (!frames) return frames.status();
  if (purpose == Purpose::kTest || entry.validation_list.empty()) {
    return listed_pack(entry, *frames);
  }
  const auto validation = open_kitti(entry, entry.validation_list, root, purpose);
  if (!validation) return validation.status();
  return split_pack(entry, *frames, *validation);
}

// The first folder of a pack whose name begins with "teacher" (teach makes `teacher`); empty: none.
std::string maps_in(const fs::path& folder) {
  const auto all = list_folder(folder);
  if (!all) return {};
  for (const fs::path& path : *all) {
    const std::string name = path.filename().string();
    if (name.rfind("teacher", 0) == 0 && fs::is_directory(path)) return name;
  }
  return {};
}

// What teach wrote beside its maps, {"align": "scale"}; without a file they are metres.
Result<Alignment> alignment_in(const fs::path& maps) {
  const fs::path file = maps / "teacher.json";
  if (!fs::exists(file)) return Alignment::kNone;
  const Result<std::string> text = dataset::read_bytes(file, kMostTeacherBytes);
  if (!text) return text.status();
  const Result<JsonValue> json = parse_json(*text);
  const JsonValue* align = json && json->items().size() == 1 ? json->find("align") : nullptr;
  const std::string name(align == nullptr ? "" : align->text().value_or(""));
  const auto found = alignment_names().find(name);
  if (found != alignment_names().end()) return found->second;
  return Status::error(StatusCode::kInvalidInput,
                       "%s: must be {\"align\": \"none\"}, or \"scale\" or \"affine\"",
                       file.c_str());
}

// A pack of the user's own: trusted, for both shapes alike. Where it has no depth of a sensor it
// has a teacher's.
Result<CatalogueEntry> own_entry(const fs::path& folder) {
  CatalogueEntry entry;
  PackUse& use = entry.use;
  entry.path = use.name = folder.filename().string();
  use.wide_share = use.tall_share = 1;
  entry.protocol = *protocol_named("rgbd");
  const std::string maps = maps_in(folder);
  if (!maps.empty()) use.maps = maps;
  if (fs::is_directory(folder / "depth")) return entry;
  if (maps.empty()) {
    return Status::error(StatusCode::kUsage,
                         "--pack %s: there is neither depth/ nor a teacher's maps in it: "
                         "`lcdm-train teach` makes some",
                         folder.c_str());
  }
  use.teacher = Teacher::kMaps;
  const Result<Alignment> alignment = alignment_in(folder / maps);
  if (!alignment) return alignment.status();
  use.alignment = *alignment;
  return entry;
}

void add(Data& data, Pack pack, const Protocol& protocol) {
  data.packs.push_back(std::move(pack));
  data.protocols.push_back(protocol);
}

void add_rendered(Data& data, Rendering rendering, const RenderedUse& use) {
  if (use.frames == 0) return;
  ScenePackOptions options;
  options.rendering = rendering;
  options.train_frames = use.frames;
  options.wide_share = use.wide_share;
  options.tall_share = use.tall_share;
  add(data, rendered_pack(options), *protocol_named("scene"));
}

// Packs of the user's own need no catalogue.
Result<Catalogue> catalogue_for(const DataOptions& options) {
  if (!options.packs.empty()) {
    Catalogue own;
    own.licence = "that of the trainer's own pictures";
    return own;
  }
  Result<Catalogue> catalogue = read_catalogue(options.catalogue);
  if (catalogue && !options.root.empty()) catalogue->root = options.root;
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

void add_data_options(CLI::App& command, DataOptions& options) {
  command.add_option("--data", options.catalogue, "Catalogue of the data (model/data/)")
      ->capture_default_str();
  command.add_option("--data-root", options.root, "Folder of the data, instead of the catalogue's");
  command.add_option("--every", options.every, "Keep every n-th frame of a pack")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command
      .add_option("--scene-frames", options.scene_frames,
                  "Rendered training frames of each kind, instead of the catalogue's number")
      ->check(CLI::Range(std::size_t{0}, kMostRenderedFrames));
  command
      .add_option("--pack", options.packs,
                  "Train on this pack (rgb/, intrinsics.json, and depth/ or a teacher's maps in "
                  "teacher*/) instead of the catalogue's; may be given again")
      ->check(CLI::ExistingDirectory);
}

Result<Data> load_training_data(const DataOptions& options) {
  const Result<Catalogue> catalogue = catalogue_for(options);
  if (!catalogue) return catalogue.status();
  Data data;
  data.licence = catalogue->licence;
  const auto take = [&](const CatalogueEntry& entry, const fs::path& root) -> Status {
    Result<Pack> pack = open_entry(entry, root, Purpose::kTrain, options.every);
    if (!pack) return pack.status();
    add(data, std::move(*pack), entry.protocol);
    return Status::ok();
  };
  for (const std::string& folder : options.packs) {
    const fs::path path = fs::canonical(folder);
    const Result<CatalogueEntry> entry = own_entry(path);
    if (!entry) return entry.status();
    LCDM_RETURN_IF_ERROR(take(*entry, path.parent_path()));
  }
  for (const CatalogueEntry& entry : catalogue->train) {
    LCDM_RETURN_IF_ERROR(take(entry, catalogue->root));
  }
  RenderedUse scene = catalogue->scene;
  RenderedUse medley = catalogue->medley;
  if (options.scene_frames) {
    scene.frames = *options.scene_frames;
    if (medley.frames > 0) medley.frames = *options.scene_frames;
  }
  add_rendered(data, Rendering::kScene, scene);
  add_rendered(data, Rendering::kMedley, medley);
  return data;
}

Result<Data> load_test_data(const DataOptions& options) {
  if (!options.packs.empty()) {
    return Status::error(StatusCode::kUsage,
                         "--pack has a validation part and no test part: leave --test out, or "
                         "write a catalogue with [[test]]");
  }
  const Result<Catalogue> catalogue = catalogue_for(options);
  if (!catalogue) return catalogue.status();
  Data data;
  data.licence = catalogue->licence;
  for (const CatalogueEntry& entry : catalogue->test) {
    Result<Pack> pack = open_entry(entry, catalogue->root, Purpose::kTest, 1);
    if (!pack) return pack.status();
    pack->train.clear();
    pack->validation.resize(pack->frames->size());
    for (std::size_t i = 0; i < pack->validation.size(); ++i) pack->validation[i] = i;
    add(data, std::move(*pack), entry.protocol);
  }
  return data;
}

}  // namespace lcdm::model
