#include "model/scene_pack.h"

#include <numeric>

#include "drivers/scene/places.h"
#include "drivers/scene/render.h"
#include "drivers/scene/textures.h"
#include "model/batch.h"

namespace lcdm::model {
namespace {

constexpr std::size_t kFramesOfWorld = 4;
constexpr double kLongestDrive = 300;  // seconds

// The training worlds first, then those to validate on.
class RenderedFrames final : public Frames {
 public:
  explicit RenderedFrames(const ScenePackOptions& options) : options_(options) {
    scene::textures();
  }

  std::size_t size() const override { return options_.train_frames + options_.validation_frames; }
  std::string name(std::size_t index) const override {
    const View view = view_of(index);
    return std::to_string(view.seed) + "-" + std::to_string(view.number);
  }
  Result<PackFrame> read(std::size_t index) const override;

 private:
  struct View {
    std::uint64_t seed;  // of its world
    std::size_t number;  // in it
  };
  View view_of(std::size_t index) const {
    const bool trains = index < options_.train_frames;
    const std::size_t i = trains ? index : index - options_.train_frames;
    const std::uint64_t first = trains ? options_.train_seed : options_.validation_seed;
    return {first + i / kFramesOfWorld, i % kFramesOfWorld};
  }

  const ScenePackOptions options_;
};

void fill(Rendering rendering, std::uint64_t seed, std::size_t number, double seconds,
          int photographs, scene::Snapshot& out) {
  if (rendering == Rendering::kMedley) {
    return scene::fill_medley(seed * kFramesOfWorld + number, photographs, out);
  }
  scene::Scene(seed).at(seconds, out);
}

Result<PackFrame> RenderedFrames::read(std::size_t index) const {
  const View view = view_of(index);
  SampleRandom random(view.seed, view.number, 0);
  const bool wide = view.number % 2 == 0;
  const int width = wide ? 640 : 384;
  const int height = wide ? 192 : 288;
  PackFrame frame;
  frame.name = name(index);
  frame.camera = CameraModel::from_field_of_view(
      width, height, static_cast<float>(wide ? random.uniform(75, 95) : random.uniform(50, 85)));
  frame.rgb.create(height, width, CV_8UC3);
  frame.depth.create(height, width, CV_32F);
  const auto snapshot = std::make_unique<scene::Snapshot>();
  // What validates stays as it is, whatever a training adds.
  const int photographs = index < options_.train_frames ? options_.photographs : 0;
  fill(options_.rendering, view.seed, view.number, random.uniform(0, kLongestDrive), photographs,
       *snapshot);
  scene::render(*snapshot, frame.camera, {frame.rgb.ptr<std::uint8_t>(), frame.rgb.total() * 3},
                {frame.depth.ptr<float>(), frame.depth.total()});
  frame.depth.setTo(kSkyDepth, frame.depth <= 0);
  return frame;
}

}  // namespace

Pack rendered_pack(const ScenePackOptions& options) {
  Pack pack;
  pack.use.name = options.rendering == Rendering::kMedley ? "medley" : "scene";
  pack.use.teacher = Teacher::kRenderer;
  pack.use.wide_share = options.wide_share;
  pack.use.tall_share = options.tall_share;
  pack.use.photographs = options.photographs;
  pack.train.resize(options.train_frames);
  std::iota(pack.train.begin(), pack.train.end(), std::size_t{0});
  pack.validation.resize(options.validation_frames);
  std::iota(pack.validation.begin(), pack.validation.end(), options.train_frames);
  pack.frames = std::make_shared<RenderedFrames>(options);
  return pack;
}

}  // namespace lcdm::model
