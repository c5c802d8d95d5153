#include "model/scene_pack.h"

#include "drivers/scene_render.h"
#include "drivers/scene_textures.h"
#include "model/batch.h"

namespace lcdm::model {
namespace {

constexpr std::size_t kFramesOfWorld = 4;
constexpr double kLongestDrive = 300;  // seconds

PackFrame render_frame(std::uint64_t seed, std::size_t index) {
  SampleRandom random(seed, index, 0);
  const bool wide = index % 2 == 0;
  const int width = wide ? 640 : 384;
  const int height = wide ? 192 : 288;
  PackFrame frame;
  frame.name = std::to_string(seed) + "-" + std::to_string(index);
  frame.camera = CameraModel::from_field_of_view(
      width, height, static_cast<float>(wide ? random.uniform(75, 95) : random.uniform(50, 85)));
  frame.rgb.create(height, width, CV_8UC3);
  frame.depth.create(height, width, CV_32F);
  scene::render(scene::Scene(seed), random.uniform(0, kLongestDrive), frame.camera,
                {frame.rgb.ptr<std::uint8_t>(), frame.rgb.total() * 3},
                {frame.depth.ptr<float>(), frame.depth.total()});
  frame.depth.setTo(kSkyDepth, frame.depth <= 0);
  return frame;
}

}  // namespace

Pack render_scene_pack(const ScenePackOptions& options) {
  scene::textures();
  Pack pack;
  pack.use.name = "scene";
  pack.use.wide_share = options.wide_share;
  pack.use.tall_share = options.tall_share;
  std::vector<PackFrame> frames;
  const auto add = [&frames](std::uint64_t first_seed, std::size_t count,
                             std::vector<std::size_t>& part) {
    for (std::size_t i = 0; i < count; ++i) {
      part.push_back(frames.size());
      frames.push_back(render_frame(first_seed + i / kFramesOfWorld, i % kFramesOfWorld));
    }
  };
  add(options.train_seed, options.train_frames, pack.train);
  add(options.validation_seed, options.validation_frames, pack.validation);
  pack.frames = std::make_shared<MemoryFrames>(std::move(frames), false);
  return pack;
}

}  // namespace lcdm::model
