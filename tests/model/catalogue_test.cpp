// Catalogues of data: what they say, and how they say what is wrong with them.
#include "model/catalogue.h"

#include <gtest/gtest.h>
#include <set>
#include <string>

#include "model/data_sets.h"
#include "tests/model/data_set_fixture.h"
#include "tests/support/temporary_folder.h"

namespace lcdm::model {
namespace {

class CatalogueTest : public testing::Test {
 protected:
  Result<Catalogue> read(const std::string& text) const {
    return read_catalogue(folder_.write("catalogue.toml", text));
  }
  void expect_fault(const std::string& text, const std::string& part) const {
    const Result<Catalogue> catalogue = read(text);
    ASSERT_FALSE(catalogue);
    EXPECT_NE(std::string(catalogue.status().text()).find(part), std::string::npos)
        << catalogue.status().text();
  }

  test::TemporaryFolder folder_;
};

TEST_F(CatalogueTest, SaysWhatEachSetIsFor) {
  const Result<Catalogue> catalogue = read(R"(
licence = "free"
root = "/data"
[scene]
frames = 8
wide-share = 0.5
[[train]]
path = "rooms"
teacher = "maps"
maps = "big_model"
align = "affine"
trust = 0.5
tall-share = 2
[[test]]
form = "kitti-raw"
path = "kitti"
list = "test_files.txt"
ground-truth = "velodyne"
protocol = "kitti"
)");
  ASSERT_TRUE(catalogue) << catalogue.status().text();
  EXPECT_EQ(catalogue->licence, "free");
  EXPECT_EQ(catalogue->scene.frames, 8U);
  ASSERT_EQ(catalogue->train.size(), 1U);
  const PackUse& use = catalogue->train[0].use;
  EXPECT_EQ(use.teacher, Teacher::kMaps);
  EXPECT_EQ(use.maps, "big_model");
  EXPECT_EQ(use.alignment, Alignment::kAffine);
  EXPECT_FLOAT_EQ(use.weight, 0.5);
  EXPECT_FLOAT_EQ(use.tall_share, 2);
  ASSERT_EQ(catalogue->test.size(), 1U);
  EXPECT_EQ(catalogue->test[0].form, CatalogueEntry::Form::kKittiRaw);
  EXPECT_EQ(catalogue->test[0].protocol.crop, Protocol::Crop::kGarg);
}

TEST_F(CatalogueTest, FaultsNameLineAndCure) {
  expect_fault("root = 5", ":1: root must be a text in quotes");
  expect_fault("[[train]]\npath = \"a\"\ntrusst = 1", "no key \"trusst\"");
  expect_fault("[[train]]\npath = \"a\"\ntrust = -1", "trust must be a number, 0 or more");
  expect_fault("[[train]]\npath = \"a\"\nteacher = \"guess\"", "one of maps, none, sensor");
  expect_fault("[[train]]\npath = \"a\"\nprotocol = \"x\"", "is no protocol");
  expect_fault("[[train]]\ntrust = 1", "has no path");
  expect_fault("[[train]]\npath = \"a\"\nvalidation-list = \"b\"",
               "\"validation-list\" says nothing");
  expect_fault("[[test]]\nform = \"nyu\"\npath = \"a\"\nteacher = \"none\"",
               "\"teacher\" says nothing");
  expect_fault("[[test]]\nform = \"make3d\"\npath = \"a\"\nalign = \"scale\"",
               "\"align\" says nothing");
  expect_fault("[[test]]\nform = \"kitti-raw\"\npath = \"a\"\nvideo = false",
               "\"video\" says nothing");
  expect_fault("[[train]]\npath = \"a\"", ":1: no wide-share or tall-share");
  expect_fault("[medley]\nframes = -1", "frames must be a number, 0 or more");
  expect_fault("[medley]\nframes = 1e8", "more would show the worlds that validate");
  expect_fault("[medley]\nphotographs = 241", "\"photographs\" is at most 240");
  expect_fault("[scene]\nphotographs = 3", "no key \"photographs\"");
  expect_fault("[train]\npath = \"a\"", "write [[train]]");
  expect_fault("[[train]\n", "catalogue.toml");
  EXPECT_EQ(read_catalogue("no/such.toml").code(), StatusCode::kInvalidInput);
}

// The committed ones: nothing of the research catalogue's licences in the open one.
TEST(Catalogues, OfTheProjectAreWellFormed) {
  const std::set<std::string> kFree = {
      "indoor_hololens_dvmvs",    // MIT
      "realsense_floor",          // MIT
      "driving_carnd_highway",    // MIT
      "driving_carnd_testvideo",  // MIT
      "lingbot_rooms",            // Apache-2.0
      "driving_pjlab",            // Apache-2.0
      "panorama_rooms",           // CC0
      "tum_offices",              // CC BY 4.0
      "tum_desk",                 // CC BY 4.0
      "tartanair_hospital",       // CC BY 4.0
  };
  const Result<Catalogue> research = read_catalogue("model/data/research.toml");
  ASSERT_TRUE(research) << research.status().text();
  const Result<Catalogue> open = read_catalogue("model/data/open.toml");
  ASSERT_TRUE(open) << open.status().text();
  const Result<Catalogue> rooms = read_catalogue("model/data/rooms.toml");
  ASSERT_TRUE(rooms) << rooms.status().text();
  EXPECT_FALSE(research->licence.empty());
  EXPECT_FALSE(rooms->licence.empty());
  EXPECT_EQ(research->test.size(), open->test.size());
  for (const CatalogueEntry& entry : open->train) {
    if (entry.use.wide_share + entry.use.tall_share == 0) continue;  // only measures
    EXPECT_TRUE(kFree.contains(entry.path)) << entry.path << " is not known to be free";
  }
}

// Without depth nothing would be learnt, and nobody told.
TEST_F(CatalogueTest, KittiNeedsASourceOfDepth) {
  DataOptions options;
  options.catalogue =
      folder_.write("catalogue.toml",
                    "[[train]]\nform = \"kitti-raw\"\npath = \"kitti\"\nlist = \"a.txt\"\n"
                    "validation-list = \"b.txt\"\nwide-share = 1\n");
  const Result<Data> data = load_training_data(options);
  ASSERT_EQ(data.code(), StatusCode::kInvalidInput);
  EXPECT_NE(std::string(data.status().text()).find("ground-truth"), std::string::npos);
}

TEST(Catalogues, OwnPacksHaveNoTestPart) {
  DataOptions options;
  options.packs = {"pack"};
  EXPECT_EQ(load_test_data(options).code(), StatusCode::kUsage);
}

// A pack of one frame, given by --pack: a teacher says 2 m everywhere.
class OwnPack : public DataSet {
 protected:
  void SetUp() override {
    write_picture(root_ / "rgb" / "000000.png", {64, 48}, {10, 100, 200});
    write(root_ / "intrinsics.json", R"({"fx": 100, "fy": 100, "cx": 32, "cy": 24})");
  }
  void write_maps(const std::string& folder) const {
    write_depth(root_ / folder / "000000.png", cv::Mat_<std::uint16_t>(48, 64, std::uint16_t{512}));
  }
  Result<Data> load() const {
    DataOptions options;
    options.packs = {root_.string()};
    return load_training_data(options);
  }
};

// What other rooms get is not told by the ends of sequences that were trained on.
TEST_F(OwnPack, NamedWithoutAShareMeasuresWhole) {
  write_depth(root_ / "depth" / "000000.png", no_depth(48, 64));
  const auto pack_with = [&](const std::string& share) {
    DataOptions options;
    options.catalogue = (root_ / "catalogue.toml").string();
    write(options.catalogue, "root = \"" + root_.parent_path().string() +
                                 "\"\n[[train]]\npath = \"" + root_.filename().string() +
                                 "\"\ntall-share = " + share + "\n");
    return load_training_data(options)->packs.at(0);
  };
  const Pack measured = pack_with("0");
  EXPECT_TRUE(measured.train.empty());
  EXPECT_EQ(measured.validation, std::vector<std::size_t>{0});
  const Pack trained = pack_with("1");
  EXPECT_EQ(trained.train, std::vector<std::size_t>{0});
  EXPECT_TRUE(trained.validation.empty()) << "too short to be split";
}

TEST_F(OwnPack, LearnsFromItsDepthAndIsComparedWithItsTeacher) {
  write_depth(root_ / "depth" / "000000.png", cv::Mat_<std::uint16_t>(48, 64, std::uint16_t{3000}));
  write_maps("teacher_meter");
  const Result<Data> data = load();
  ASSERT_TRUE(data) << data.status().text();
  const Pack& pack = data->packs.at(0);
  EXPECT_FLOAT_EQ(pack.frames->read(0)->depth.at<float>(0, 0), 3);
  EXPECT_EQ(maps_beside_depth(pack), fs::canonical(root_) / "teacher_meter");
}

TEST_F(OwnPack, LearnsFromItsTeacherWhereItHasNoDepth) {
  write_maps("teacher");
  write_maps("teacher_meter");
  const Result<Data> data = load();
  ASSERT_TRUE(data) << data.status().text();
  const Pack& pack = data->packs.at(0);
  EXPECT_EQ(pack.use.maps, "teacher") << "which `lcdm-train teach` makes";
  EXPECT_FLOAT_EQ(pack.frames->read(0)->depth.at<float>(0, 0), 2);
  EXPECT_TRUE(maps_beside_depth(pack).empty()) << "nothing to compare it with";
}

// A module's inverse depth has no metres: `teach` says so beside its maps.
TEST_F(OwnPack, AlignsItsTeacherAsThatSays) {
  write_maps("teacher");
  EXPECT_EQ(load()->packs.at(0).use.alignment, Alignment::kNone);
  write(root_ / "teacher" / "teacher.json", R"({"align": "affine"})");
  EXPECT_EQ(load()->packs.at(0).use.alignment, Alignment::kAffine);
  for (const char* text : {"{}", "[]", R"({"align": "median"})", R"({"align": 1})",
                           R"({"align": "scale", "trust": 1})", "align = scale"}) {
    write(root_ / "teacher" / "teacher.json", text);
    const Result<Data> data = load();
    ASSERT_EQ(data.code(), StatusCode::kInvalidInput) << text;
    EXPECT_NE(std::string(data.status().text()).find("teacher.json: must be"), std::string::npos);
  }
  write_depth(root_ / "depth" / "000000.png", no_depth(48, 64));
  EXPECT_TRUE(load()) << "its own depth is what it learns from";
}

TEST_F(OwnPack, KeepsItsTeachersLicence) {
  write_maps("teacher");
  const std::string own = load()->licence;
  write(root_ / "teacher" / "teacher.json", R"({"align": "scale", "licence": "for one only"})");
  EXPECT_EQ(load()->licence, own + "; taught by maps of a network under: for one only");
  EXPECT_EQ(load()->packs.at(0).use.alignment, Alignment::kScale);
}

// A catalogue need not repeat it, and may know better.
TEST_F(OwnPack, OfACatalogueAlignsItsTeacherAlike) {
  write_maps("teacher");
  write(root_ / "teacher" / "teacher.json", R"({"align": "affine"})");
  const auto alignment_with = [&](const std::string& line) {
    DataOptions options;
    options.catalogue = (root_ / "catalogue.toml").string();
    write(options.catalogue, "root = \"" + root_.parent_path().string() +
                                 "\"\n[[train]]\npath = \"" + root_.filename().string() +
                                 "\"\ntall-share = 1\nteacher = \"maps\"\n" + line);
    return load_training_data(options)->packs.at(0).use.alignment;
  };
  EXPECT_EQ(alignment_with(""), Alignment::kAffine);
  EXPECT_EQ(alignment_with("align = \"none\"\n"), Alignment::kNone);
}

// The right depth would look wrong beside maps of a shift nobody knows.
TEST_F(OwnPack, MeasuresNothingByMapsOfUnknownShift) {
  write_maps("teacher");
  const auto measured_with = [&](const char* align) {
    DataOptions options;
    options.catalogue = (root_ / "catalogue.toml").string();
    write(options.catalogue, "root = \"" + root_.parent_path().string() +
                                 "\"\n[[train]]\npath = \"" + root_.filename().string() +
                                 "\"\ntall-share = 0\nteacher = \"maps\"\nalign = \"" + align +
                                 "\"\n");
    return load_training_data(options)->packs.at(0).validation.size();
  };
  EXPECT_EQ(measured_with("scale"), 1U);
  EXPECT_EQ(measured_with("affine"), 0U);
}

TEST_F(OwnPack, WithoutAnyDepthIsToldWhatMakesSome) {
  const Result<Data> data = load();
  ASSERT_EQ(data.code(), StatusCode::kUsage);
  EXPECT_NE(std::string(data.status().text()).find("lcdm-train teach"), std::string::npos);
}

// Recordings of a depth camera, as the paper's own: nothing counts nearer than .1 m or beyond 10 m.
TEST_F(OwnPack, IsMeasuredAsRgbdRecordingsAre) {
  write_depth(root_ / "depth" / "000000.png", no_depth(48, 64));
  const Result<Data> data = load();
  ASSERT_TRUE(data) << data.status().text();
  EXPECT_FLOAT_EQ(data->protocols[0].nearest, 0.1);
  EXPECT_FLOAT_EQ(data->protocols[0].farthest, 10);
}

TEST_F(CatalogueTest, LoadsTheSceneAlone) {
  DataOptions options;
  options.catalogue = folder_.write("catalogue.toml", "[scene]\nframes = 4\n");
  const Result<Data> data = load_training_data(options);
  ASSERT_TRUE(data) << data.status().text();
  ASSERT_EQ(data->packs.size(), 1U);
  EXPECT_EQ(data->packs[0].train.size(), 4U);
}

}  // namespace
}  // namespace lcdm::model
