#include "model/batch.h"

#include <algorithm>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "model/depth_code.h"
#include "model/pasted_things.h"
#include "model/pixel_scale.h"

namespace lcdm::model {
namespace {

constexpr int kDrawsPerSample = 8;    // of frames, until one can be read
constexpr double kSteepestRoll = 10;  // degrees

cv::Rect random_crop(cv::Size full, double aspect, SampleRandom& random) {
  const double scale = random.chance(0.3) ? 1 : random.uniform(0.45, 1);
  const double width = std::min<double>(full.width, full.height * aspect) * scale;
  cv::Rect crop;
  crop.width = std::clamp(cvRound(width), 16, full.width);
  crop.height = std::clamp(cvRound(width / aspect), 16, full.height);
  crop.x = static_cast<int>(random.below(static_cast<std::size_t>(full.width - crop.width + 1)));
  crop.y = static_cast<int>(random.below(static_cast<std::size_t>(full.height - crop.height + 1)));
  return crop;
}

// Brightness, contrast, saturation, white balance and gamma; one picture in ten without colour.
void jitter_colour(cv::Mat& rgb, SampleRandom& random) {
  const double gain = random.uniform(0.65, 1.35);
  const double contrast = random.uniform(0.65, 1.35);
  const double saturation = random.chance(0.1) ? 0 : random.uniform(0.5, 1.5);
  const double gamma = random.uniform(0.7, 1.4);
  const cv::Scalar balance(random.uniform(0.85, 1.15), 1, random.uniform(0.85, 1.15));
  cv::Mat grey;
  cv::cvtColor(rgb, grey, cv::COLOR_RGB2GRAY);
  const double mean = cv::mean(grey)[0];
  cv::Mat grey3;
  cv::cvtColor(grey, grey3, cv::COLOR_GRAY2RGB);
  cv::Mat mixed = rgb * (saturation * contrast) + grey3 * ((1 - saturation) * contrast);
  mixed += cv::Scalar::all(mean * (1 - contrast));
  cv::multiply(mixed, balance, mixed, gain);
  mixed = cv::min(cv::max(mixed, 0.0), 1.0);
  cv::pow(mixed, gamma, rgb);
}

// What cheap and moving cameras do to a picture: blur, and noise of the sensor.
void degrade(cv::Mat& rgb, SampleRandom& random) {
  if (random.chance(0.2)) cv::GaussianBlur(rgb, rgb, {}, random.uniform(0.4, 1.2));
  if (!random.chance(0.3)) return;
  cv::Mat noise(rgb.size(), rgb.type());
  cv::RNG generator(random.seed());
  generator.fill(noise, cv::RNG::NORMAL, 0, random.uniform(0.005, 0.04));
  rgb = cv::min(cv::max(rgb + noise, 0.0), 1.0);
}

// The camera rolls about its optical axis: depth stays what it is. The corners that come into view
// are mirrored colour of unknown depth.
void roll(PackFrame& frame, SampleRandom& random) {
  const cv::Mat turn = cv::getRotationMatrix2D({frame.camera.cx, frame.camera.cy},
                                               random.uniform(-kSteepestRoll, kSteepestRoll), 1);
  const cv::Size size = frame.rgb.size();
  cv::Mat turned;
  cv::warpAffine(frame.rgb, turned, turn, size, cv::INTER_LINEAR, cv::BORDER_REFLECT_101);
  frame.rgb = std::exchange(turned, {});
  cv::warpAffine(frame.depth, turned, turn, size, cv::INTER_NEAREST, cv::BORDER_CONSTANT);
  frame.depth = turned;
}

// The frame beside `index` in time, which must be of its size to be cut alike.
Result<cv::Mat> neighbour_of(const Pack& pack, std::size_t index, int offset, cv::Size size) {
  Result<cv::Mat> picture = pack.frames->neighbour(index, offset);
  if (!picture || picture->size() == size) return picture;
  return Status::error(StatusCode::kCorrupt,
                       "%s: the frame beside it in time has %dx%d pixels, it has %dx%d: set "
                       "video = false, or keep pictures of one size in a sequence",
                       pack.frames->name(index).c_str(), picture->cols, picture->rows, size.width,
                       size.height);
}

const Pack& draw_pack(const std::vector<Pack>& packs, bool wide, SampleRandom& random) {
  const auto share = [wide](const Pack& p) {
    return p.train.empty() ? 0.0F : (wide ? p.use.wide_share : p.use.tall_share);
  };
  double total = 0;
  for (const Pack& pack : packs) total += share(pack);
  double left = random.uniform(0, total);
  for (const Pack& pack : packs) {
    left -= share(pack);
    if (left < 0) return pack;
  }
  return packs.back();
}

}  // namespace

SampleRandom::SampleRandom(std::uint64_t seed, std::uint64_t step, std::uint64_t sample)
    : state_(seed * 0x9E3779B97F4A7C15U + step * 0xD1B54A32D192ED03U +
             sample * 0x8CB92BA72F3D8DD7U) {
  next();
}

// splitmix64.
std::uint64_t SampleRandom::next() {
  std::uint64_t z = (state_ += 0x9E3779B97F4A7C15U);
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9U;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBU;
  return z ^ (z >> 31);
}

double SampleRandom::uniform(double low, double high) {
  return low + (high - low) * static_cast<double>(next() >> 11) * 0x1p-53;
}

std::size_t SampleRandom::below(std::size_t n) { return static_cast<std::size_t>(next() % n); }

torch::Tensor normalised(const cv::Mat& rgb) {
  cv::Mat out;
  const double unit = rgb.depth() == CV_8U ? 1.0 / 255 : 1;
  constexpr double kDeviation = kOurPixels.deviation[0];  // the same of every colour
  rgb.convertTo(out, CV_32FC3, unit / kDeviation, -kOurPixels.mean[0] / kDeviation);
  return torch::from_blob(out.data, {out.rows, out.cols, 3}, torch::kFloat32).clone();
}

Result<AugmentedSample> augment(const Pack& pack, std::size_t index, const BatchShape& shape,
                                SampleRandom& random) {
  Result<PackFrame> read = pack.frames->read(index);
  if (!read) return read.status();
  PackFrame& frame = *read;
  const bool views = shape.views && pack.frames->has_neighbours(index);
  if (!views && pack.use.things > 0 && random.chance(pack.use.things)) {
    paste_things(random.seed(), frame);
  }
  if (!views && random.chance(0.4)) roll(frame, random);
  const double aspect = shape.squeeze * shape.width / shape.height * random.uniform(0.88, 1.14);
  const cv::Rect crop = random_crop(frame.rgb.size(), aspect, random);
  const cv::Size size(shape.width, shape.height);
  AugmentedSample out;

  CameraModel cut = frame.camera;
  cut.width = crop.width;
  cut.height = crop.height;
  cut.cx -= static_cast<float>(crop.x);
  cut.cy -= static_cast<float>(crop.y);
  out.camera = cut.resized(size.width, size.height);

  const auto cut_out = [&](const cv::Mat& picture) {
    cv::Mat rgb;
    cv::resize(picture(crop), rgb, size, 0, 0,
               crop.width > size.width ? cv::INTER_AREA : cv::INTER_LINEAR);
    rgb.convertTo(rgb, CV_32FC3, 1.0 / 255);
    return rgb;
  };
  out.plain = cut_out(frame.rgb);
  out.rgb = out.plain.clone();
  jitter_colour(out.rgb, random);
  degrade(out.rgb, random);
  cv::resize(frame.depth(crop), out.depth, size, 0, 0, cv::INTER_NEAREST_EXACT);
  out.depth *= shape.canonical_focal / out.camera.fx;
  if (views) {
    const Result<cv::Mat> earlier = neighbour_of(pack, index, -1, frame.rgb.size());
    const Result<cv::Mat> later = neighbour_of(pack, index, 1, frame.rgb.size());
    if (!earlier || !later) return (earlier ? later : earlier).status();
    out.earlier = cut_out(*earlier);
    out.later = cut_out(*later);
  }
  if (random.chance(0.5)) {
    for (cv::Mat* picture : {&out.rgb, &out.plain, &out.depth, &out.earlier, &out.later}) {
      if (!picture->empty()) cv::flip(*picture, *picture, 1);
    }
    out.camera.cx = static_cast<float>(size.width - 1) - out.camera.cx;
  }
  return out;
}

namespace {

// [H, W, channels] -> [channels, H, W], its own memory.
torch::Tensor planes_of(const cv::Mat& picture) {
  return torch::from_blob(picture.data, {picture.rows, picture.cols, picture.channels()},
                          torch::kFloat32)
      .permute({2, 0, 1})
      .clone(torch::MemoryFormat::Contiguous);
}

void add_views(const AugmentedSample& sample, std::int64_t i, Views& views) {
  const bool present = !sample.earlier.empty();
  views.here[i] = planes_of(sample.plain);
  views.earlier[i] = planes_of(present ? sample.earlier : sample.plain);
  views.later[i] = planes_of(present ? sample.later : sample.plain);
  views.present[i] = present ? 1.0F : 0.0F;
}

}  // namespace

namespace {

// A random sample of a random pack; other draws follow where a frame cannot be read.
struct Draw {
  const Pack* pack = nullptr;
  AugmentedSample sample;
};
Result<Draw> draw_sample(const std::vector<Pack>& packs, const BatchShape& shape,
                         SampleRandom& random, Batch& batch) {
  for (int i = 0; i < kDrawsPerSample; ++i) {
    const Pack& pack = draw_pack(packs, shape.wide, random);
    const std::size_t index = pack.train[random.below(pack.train.size())];
    Result<AugmentedSample> sample = augment(pack, index, shape, random);
    if (sample) return Draw{&pack, std::move(*sample)};
    batch.why_unreadable = sample.status();
    ++batch.unreadable;
  }
  return batch.why_unreadable;
}

// Number of the pack among those whose intrinsics are learned; -1: it is none of them.
std::int64_t learned_camera_of(const std::vector<Pack>& packs, const Pack& pack) {
  if (!pack.use.learn_intrinsics) return -1;
  return std::count_if(packs.data(), &pack, [](const Pack& p) { return p.use.learn_intrinsics; });
}

Target empty_target(const BatchShape& shape) {
  const std::int64_t n = shape.images;
  return {torch::empty({n, 1, shape.height, shape.width}), torch::zeros({n}), torch::zeros({n}),
          torch::zeros({n}, torch::kLong)};
}

}  // namespace

Result<Batch> make_batch(const std::vector<Pack>& packs, const BatchShape& shape,
                         std::uint64_t seed, std::uint64_t number) {
  const auto n = static_cast<std::int64_t>(shape.images);
  const std::vector<std::int64_t> colours = {n, 3, shape.height, shape.width};
  std::vector<CameraModel> cameras;
  std::vector<torch::Tensor> rgb;
  Batch batch;
  Target& target = batch.target;
  target = empty_target(shape);
  batch.learned_camera = torch::empty({n}, torch::kLong);
  if (shape.views) {
    batch.views = {torch::empty(colours), torch::empty(colours), torch::empty(colours),
                   torch::zeros({n})};
  }
  for (std::int64_t i = 0; i < n; ++i) {
    SampleRandom random(seed, number, static_cast<std::uint64_t>(shape.first + i));
    const Result<Draw> draw = draw_sample(packs, shape, random, batch);
    if (!draw) return draw.status();
    const PackUse& use = draw->pack->use;
    rgb.push_back(normalised(draw->sample.rgb));
    cameras.push_back(draw->sample.camera);
    batch.learned_camera[i] = learned_camera_of(packs, *draw->pack);
    target.depth[i] = planes_of(draw->sample.depth);
    target.weight[i] = use.weight;
    target.sharp[i] = use.teacher == Teacher::kMaps ? 0.0F : 1.0F;
    target.alignment[i] = static_cast<std::int64_t>(use.alignment);
    if (shape.views) add_views(draw->sample, i, batch.views);
  }
  batch.rgb = torch::stack(rgb).permute({0, 3, 1, 2});
  batch.cameras = pinholes_of(cameras);
  return batch;
}

Batch Batch::map(const std::function<torch::Tensor(const torch::Tensor&)>& change) const {
  const auto of = [&](const torch::Tensor& all) { return all.defined() ? change(all) : all; };
  Batch out;
  out.rgb = of(rgb);
  out.cameras = {of(cameras.fx), of(cameras.fy), of(cameras.cx), of(cameras.cy)};
  out.learned_camera = of(learned_camera);
  out.target = {of(target.depth), of(target.weight), of(target.sharp), of(target.alignment)};
  out.views = {of(views.here), of(views.earlier), of(views.later), of(views.present)};
  out.unreadable = unreadable;
  out.why_unreadable = why_unreadable;
  return out;
}

Batch Batch::part(std::int64_t first, std::int64_t count) const {
  return map([&](const torch::Tensor& all) { return all.narrow(0, first, count); });
}

Batch Batch::to(const torch::Device& device) const {
  return map([&](const torch::Tensor& all) { return all.to(device); });
}

void DrawnFrames::add(const Batch& batch) {
  drawn_ += batch.rgb.size(0);
  unreadable_ += batch.unreadable;
  if (batch.unreadable > 0) why_ = batch.why_unreadable;
}

Status DrawnFrames::check() const {
  constexpr std::int64_t kFew = 10;
  constexpr double kMostUnreadable = 0.02;  // of those drawn
  const bool few = unreadable_ < kFew ||
                   static_cast<double>(unreadable_) < kMostUnreadable * static_cast<double>(drawn_);
  if (few) return Status::ok();
  return Status::error(
      StatusCode::kCorrupt, "%lld of %lld drawn frames cannot be read: mend the data; the last: %s",
      static_cast<long long>(unreadable_), static_cast<long long>(drawn_), why_.text());
}

std::string DrawnFrames::note() const {
  if (unreadable_ == 0) return {};
  return std::to_string(unreadable_) +
         " frames could not be read and were replaced by others; the last: " + why_.text();
}

BatchLoader::BatchLoader(const std::vector<Pack>& packs, std::vector<BatchShape> shapes,
                         std::uint64_t seed, std::uint64_t first, std::size_t ahead)
    : packs_(packs), shapes_(std::move(shapes)), seed_(seed), number_(first) {
  while (running_.size() < ahead) start_one();
}

void BatchLoader::start_one() {
  running_.push_back(std::async(std::launch::async, [this, number = number_] {
    return make_batch(packs_, shapes_[number % shapes_.size()], seed_, number);
  }));
  ++number_;
}

Result<Batch> BatchLoader::next() {
  Result<Batch> batch = running_.front().get();
  running_.pop_front();
  start_one();
  return batch;
}

}  // namespace lcdm::model
