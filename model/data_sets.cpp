#include "model/data_sets.h"

#include <algorithm>
#include <filesystem>
#include <numeric>

#include "firmware/base/folder.h"
#include "firmware/nn/json.h"
#include "model/catalogue.h"
#include "model/dataset_files.h"
#include "model/kitti_raw.h"
#include "model/make3d.h"
#include "model/nyu_depth.h"
#include "model/photographs.h"
#include "model/scene_pack.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;
using Form = CatalogueEntry::Form;

constexpr std::size_t kMostTeacherBytes = 1U << 12;  // of a teacher.json

enum class Purpose : std::uint8_t { kTrain, kTest };

// Wider pictures are reduced: never for a test.
int width_for(Purpose purpose) { return purpose == Purpose::kTrain ? 640 : kFullWidth; }

// What teach wrote beside its maps, {"align": "scale", "licence": "..."}. Without a file they are
// metres; without a licence nothing is known of one.
struct TeacherNote {
  Alignment alignment = Alignment::kNone;
  std::string licence;
};

Result<TeacherNote> note_beside(const fs::path& maps) {
  const fs::path file = maps / "teacher.json";
  TeacherNote note;
  if (!fs::exists(file)) return note;
  const Result<std::string> text = dataset::read_bytes(file, kMostTeacherBytes);
  if (!text) return text.status();
  const Result<JsonValue> json = parse_json(*text);
  const JsonValue* align = json ? json->find("align") : nullptr;
  const JsonValue* licence = json ? json->find("licence") : nullptr;
  const std::string name(align == nullptr ? "" : align->text().value_or(""));
  const auto found = alignment_names().find(name);
  if (found == alignment_names().end() || json->items().size() != (licence == nullptr ? 1U : 2U)) {
    return Status::error(StatusCode::kInvalidInput,
                         "%s: must be {\"align\": \"none\"}, or \"scale\" or \"affine\", and may "
                         "have a \"licence\"",
                         file.c_str());
  }
  note.alignment = found->second;
  if (licence != nullptr) note.licence = licence->text().value_or("");
  return note;
}

// A set in one order, split as packs are: what validates has no neighbours that train.
Pack ordered_pack(const CatalogueEntry& entry, std::shared_ptr<const Frames> frames) {
  std::vector<std::string> names;
  for (std::size_t i = 0; i < frames->size(); ++i) names.push_back(frames->name(i));
  Split split = split_frames(names);
  Pack pack;
  pack.use = entry.use;
  pack.frames = std::move(frames);
  pack.train = std::move(split.train);
  pack.validation = std::move(split.validation);
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

// Where the entry leaves it open, what the maps need is what teach wrote beside them. Whoever
// learns from a teacher's maps has its licence to keep.
Status heed_note(CatalogueEntry& entry, const fs::path& root, std::string& licence) {
  if (entry.use.teacher != Teacher::kMaps) return Status::ok();
  const fs::path maps =
      entry.form == Form::kPack ? root / entry.path / entry.use.maps : root / entry.use.maps;
  const Result<TeacherNote> note = note_beside(maps);
  if (!note) return note.status();
  if (!entry.says_align) entry.use.alignment = note->alignment;
  if (!note->licence.empty() && licence.find(note->licence) == std::string::npos) {
    licence += "; taught by maps of a network under: " + note->licence;
  }
  return Status::ok();
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
    return ordered_pack(entry, *frames);
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

// A pack of the user's own: trusted, for both shapes alike. Where it has no depth of a sensor it
// has a teacher's.
Result<CatalogueEntry> own_entry(const fs::path& folder, bool video) {
  CatalogueEntry entry;
  PackUse& use = entry.use;
  entry.path = use.name = folder.filename().string();
  use.wide_share = use.tall_share = 1;
  use.video = video;
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
  return entry;
}

// A set that nothing is trained on has no neighbours to keep away from: all of it measures.
void validate_on_all(Pack& pack) {
  pack.train.clear();
  pack.validation.resize(pack.frames->size());
  std::iota(pack.validation.begin(), pack.validation.end(), std::size_t{0});
}

void add(Data& data, Pack pack, const Protocol& protocol) {
  // A shift nobody knows is nothing to measure by: the right depth would look wrong.
  const bool shifted = pack.use.alignment == Alignment::kAffine;
  if (pack.use.teacher == Teacher::kMaps && shifted) pack.validation.clear();
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
  options.photographs = use_photographs_of(data.packs, use.photographs);
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
  auto* pack =
      command
          .add_option("--pack", options.packs,
                      "Train on this pack (rgb/, intrinsics.json, and depth/ or a teacher's maps "
                      "in teacher*/) instead of the catalogue's; may be given again")
          ->check(CLI::ExistingDirectory);
  command
      .add_flag("--video", options.video,
                "The pictures of --pack are a video: neighbouring names are neighbours in time")
      ->needs(pack);
}

void add_test_option(CLI::App& command, bool& test) {
  command.add_flag("--test", test, "The test sets instead of the validation parts")
      ->excludes(command.get_option("--every"))  // every frame of theirs counts
      ->excludes(command.get_option("--scene-frames"));
}

Result<Data> load_training_data(const DataOptions& options) {
  const Result<Catalogue> catalogue = catalogue_for(options);
  if (!catalogue) return catalogue.status();
  Data data;
  data.licence = catalogue->licence;
  const auto take = [&](CatalogueEntry entry, const fs::path& root) -> Status {
    LCDM_RETURN_IF_ERROR(heed_note(entry, root, data.licence));
    Result<Pack> pack = open_entry(entry, root, Purpose::kTrain, options.every);
    if (!pack) return pack.status();
    const bool trains = entry.use.wide_share + entry.use.tall_share > 0;
    if (!trains && entry.validation_list.empty()) validate_on_all(*pack);
    add(data, std::move(*pack), entry.protocol);
    return Status::ok();
  };
  for (const std::string& folder : options.packs) {
    const fs::path path = fs::canonical(folder);
    const Result<CatalogueEntry> entry = own_entry(path, options.video);
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
  for (CatalogueEntry entry : catalogue->test) {
    LCDM_RETURN_IF_ERROR(heed_note(entry, catalogue->root, data.licence));
    Result<Pack> pack = open_entry(entry, catalogue->root, Purpose::kTest, 1);
    if (!pack) return pack.status();
    validate_on_all(*pack);
    add(data, std::move(*pack), entry.protocol);
  }
  return data;
}

Status require_frames(const Data& data, bool test) {
  const bool any = std::any_of(data.packs.begin(), data.packs.end(),
                               [](const Pack& pack) { return !pack.validation.empty(); });
  if (any) return Status::ok();
  return Status::error(StatusCode::kUsage, "nothing to evaluate on: %s",
                       test ? "the catalogue has no [[test]]"
                            : "no set has a validation part (sequences under 34 frames only "
                              "train)");
}

}  // namespace lcdm::model
