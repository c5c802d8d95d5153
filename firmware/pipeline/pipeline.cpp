// The way of a frame:
//
//   camera --dequeue--> capture thread --mailbox, newest wins--> infer thread --offer--> sinks
//      ^                     |                                       |
//      +------requeue--------+<------ a dropped FrameRef comes back -+
//
// Buffers are never copied on the way: a FrameRef moves, and its last drop returns the buffer to
// the capture thread. At most three are away from the driver: one waiting, one in work, one that
// is being replaced.
#include "firmware/pipeline/pipeline.h"

#include <algorithm>
#include <cstdio>
#include <utility>

#include "firmware/base/alloc_watch.h"
#include "firmware/base/os.h"

namespace lcdm {
namespace {

using std::chrono::milliseconds;

// These bound how long stop() takes.
constexpr milliseconds kLongestDequeue{300};
constexpr milliseconds kTakeTimeout{200};

// However long a frame takes, depth comes in time for the supervisor.
constexpr std::int64_t kLongestRestNs = 2'000'000'000;

// How long three frames take: a camera that gives none for so long has lost some. A driver that
// tells of less than the half frame a second that can be asked for is not believed: silence must be
// judged before the supervisor does it.
milliseconds three_periods(float frames_per_second) {
  if (frames_per_second <= 0) return milliseconds(100);
  return milliseconds(static_cast<int>(std::clamp(3000 / frames_per_second, 30.0F, 6'000.0F)));
}

// Whether time, the recovery ladder or somebody at the machine may cure a camera that cannot be
// opened or started while the program waits. Wrong configuration needs another start.
bool may_recover(const Status& fault) {
  switch (fault.code()) {
    case StatusCode::kNotFound:
    case StatusCode::kDeviceGone:
    case StatusCode::kUnavailable:
    case StatusCode::kIoError:
      return true;
    default:
      return false;
  }
}

Pipeline::EngineView view_of(const Engine& engine) {
  return {engine.stats(), engine.depth_camera(), engine.scale()};
}

std::size_t area_of(const CameraModel& camera) {
  return static_cast<std::size_t>(camera.width) * static_cast<std::size_t>(camera.height);
}

}  // namespace

Pipeline::Pipeline(Camera& camera, EngineFactory make_engine, FrameDecoder* decoder,
                   std::vector<DepthSink*> sinks, const PipelineOptions& options,
                   EngineFactory make_small_engine)
    : camera_(camera),
      make_engine_(std::move(make_engine)),
      make_small_engine_(std::move(make_small_engine)),
      decoder_(decoder),
      sinks_(std::move(sinks)),
      options_(options),
      has_small_engine_(make_small_engine_ != nullptr),
      ladder_(options_.recovery, os::monotonic_ns()) {}

Status Pipeline::start() {
  LCDM_CHECK(!infer_thread_.joinable());
  health_.set_state(PipelineState::kStarting);
  Status opened = configure_camera();
  const Status prepared = opened ? prepare_engine(source()) : Status::ok();
  if (opened && prepared) opened = camera_.start();
  const bool waits = !opened && options_.port != nullptr && may_recover(opened);
  if (!prepared || (!opened && !waits)) {
    camera_.stop();
    health_.set_state(PipelineState::kStopped);
    return prepared ? opened : prepared;
  }
  if (waits) declare(opened);
  if (!pool_) {
    const std::lock_guard lock(mutex_);
    source_.info = {camera_.info().uri, "not open yet"};
  }
  stopping_ = false;
  prepared_generation_ = generation_;
  health_.beat_infer(os::monotonic_ns());  // its last one was before the camera's start
  infer_thread_ = std::thread([this] { infer_loop(); });
  capture_thread_ = std::thread([this, opened] { capture_loop(opened); });
  return Status::ok();
}

void Pipeline::stop() {
  stopping_ = true;
  mailbox_.close();
  if (capture_thread_.joinable()) capture_thread_.join();
  if (infer_thread_.joinable()) infer_thread_.join();
  health_.set_state(PipelineState::kStopped);
}

// ---- capture thread -----------------------------------------------------------------------------

void Pipeline::capture_loop(const Status& opened) {
  os::set_thread_name("capture");
  last_frame_ns_ = os::monotonic_ns();
  bool more = opened || recover(opened);
  while (more && !stopping_) {
    health_.beat_capture(os::monotonic_ns());
    if (const Status given = give_back_returned(); !given) {
      more = survive(given);
      continue;
    }
    const auto captured = camera_.dequeue(std::min(three_periods_, kLongestDequeue));
    if (captured) {
      forward(*captured);
      more = judge_depth();
    } else {
      more = survive(captured.status());
    }
  }
  alloc_watch::unseal_thread();
  stop_camera();
}

void Pipeline::forward(const CapturedFrame& captured) {
  last_frame_ns_ = os::monotonic_ns();
  if (captured.stamp != stamp_) note_stamp(captured.stamp);
  health_.note_captured(captured.view.meta.sequence);
  mailbox_.put({pool_->lend(captured.index, captured.view), generation_});
  health_.set_dropped(mailbox_.dropped());
  if (options_.seal_capture) alloc_watch::seal_thread();  // steady from here on
}

// What the camera's stamps mean has changed: the status must not say more than they do.
void Pipeline::note_stamp(StampSource stamp) {
  const std::lock_guard lock(mutex_);
  source_.info.stamp = stamp_ = stamp;
}

// A buffer that the camera refuses is lost until the stream starts anew.
Status Pipeline::give_back_returned() {
  while (const std::optional<int> index = pool_->take_returned()) {
    LCDM_RETURN_IF_ERROR(camera_.requeue(*index));
  }
  return Status::ok();
}

void Pipeline::stop_camera() {
  mailbox_.clear();
  health_.set_dropped(mailbox_.dropped());
  wait_until_nothing_is_lent();
  camera_.stop();
}

// Ends within one inference: the infer thread never holds a frame longer.
void Pipeline::wait_until_nothing_is_lent() {
  while (pool_ && pool_->count(FramePool::State::kLent) > 0) {
    if (stopping_) mailbox_.clear();  // infer may have ended and take it no more
    health_.beat_capture(os::monotonic_ns());
    std::this_thread::sleep_for(milliseconds(2));
  }
}

// Opens the camera and makes a new generation of buffers. Nothing may be lent.
Status Pipeline::configure_camera() {
  LCDM_RETURN_IF_ERROR(camera_.configure(options_.request));
  pool_.emplace(camera_.buffer_count());
  ++generation_;
  const CameraInfo info = camera_.info();
  three_periods_ = three_periods(info.frames_per_second);
  stamp_ = info.stamp;
  const std::lock_guard lock(mutex_);
  source_ = {info, camera_.format(), camera_.model()};
  return Status::ok();
}

// ---- infer thread -------------------------------------------------------------------------------

void Pipeline::infer_loop() {
  os::set_thread_name("infer");
  last_depth_ns_ = os::monotonic_ns();
  while (!stopping_) {
    health_.beat_infer(os::monotonic_ns());
    const std::optional<Captured> captured = mailbox_.take(kTakeTimeout);
    if (!captured || stopping_) continue;
    if (captured->generation != prepared_generation_) follow_source(captured->generation);
    alloc_watch::seal_thread();  // steady from here on
    if (resting()) {
      health_.note_skipped();
      continue;
    }
    if (const Status status = infer(captured->frame.view()); !status) note_fault(status);
  }
  alloc_watch::unseal_thread();
}

// A processor that works half the time only cools down. Frames that come meanwhile are skipped.
bool Pipeline::resting() const { return rests(effort_) && os::monotonic_ns() < rest_until_ns_; }

// Frames come, but no depth: one is a count, a silence is a state.
void Pipeline::note_fault(const Status& status) {
  status.code() == StatusCode::kCorrupt ? health_.note_corrupt() : health_.note_failed();
  const auto silence = std::chrono::nanoseconds(os::monotonic_ns() - last_depth_ns_);
  if (silence < options_.no_signal_after) return;
  health_.set_state(PipelineState::kNoSignal);
  set_fault(status.text());
  only_corrupt_ = status.code() == StatusCode::kCorrupt && silence >= patience();
}

// The camera was opened again: when it looks different now, the engine is made anew for it.
void Pipeline::follow_source(std::uint64_t generation) {
  alloc_watch::unseal_thread();
  prepared_generation_ = generation;
  // Stable while a frame is lent: the capture thread reopens only when none is.
  const Source now = source();
  if (engine_ && now.format == prepared_format_ && now.model == prepared_model_) return;
  engine_status_ = prepare_engine(now);
}

// Makes decoder, engine and depth image for `source`. On error there is no engine, and every
// frame of this source counts as failed.
Status Pipeline::prepare_engine(const Source& source) {
  engine_.reset();  // their memory first: four may not fit
  small_engine_.reset();
  prepared_format_ = source.format;
  prepared_model_ = source.model;
  const Result<FrameFormat> pixels = prepare_pixels(decoder_, source.format);
  if (!pixels) return pixels.status();
  LCDM_RETURN_IF_ERROR(make_engines(*pixels, source.model));
  const EngineView full = view_of(*engine_);
  const EngineView small = small_engine_ ? view_of(*small_engine_) : full;
  millimetres_.assign(std::max(area_of(full.depth_camera), area_of(small.depth_camera)), 0);
  const std::lock_guard lock(mutex_);
  view_ = full;
  small_view_ = small;
  return Status::ok();
}

// This takes a slow board seconds: each step is a sign of life.
Status Pipeline::make_engines(const FrameFormat& pixels, const CameraModel& model) {
  const Alive alive = [this] { health_.note_prepared(os::monotonic_ns()); };
  alive();
  Result<std::unique_ptr<Engine>> made = make_engine_(pixels, model, alive);
  alive();
  if (!made) return made.status();
  engine_ = std::move(*made);
  if (make_small_engine_) {
    Result<std::unique_ptr<Engine>> small = make_small_engine_(pixels, model, alive);
    alive();
    if (small) small_engine_ = std::move(*small);  // else do without: depth waits for no spare
  }
  has_small_engine_ = small_engine_ != nullptr;
  return Status::ok();
}

Status Pipeline::infer(const FrameView& captured) {
  if (!engine_) return engine_status_;
  const bool small = takes_small_network(effort_) && small_engine_;
  Engine& engine = small ? *small_engine_ : *engine_;
  const std::int64_t begin_ns = os::monotonic_ns();
  const Result<FrameView> pixels = pixels_of(decoder_, captured);
  if (!pixels) return pixels.status();
  DepthFrame frame;
  frame.meta = captured.meta;
  frame.camera = engine.depth_camera();
  frame.scale = engine.scale();
  frame.millimetres = millimetres_.data();
  frame.colour = captured;
  frame.pixels = *pixels;
  LCDM_RETURN_IF_ERROR(
      engine.run(*pixels, {frame.camera.width, frame.camera.height, millimetres_.data(), nullptr}));
  frame.done_ns = os::monotonic_ns();
  frame.inference_ns = frame.done_ns - begin_ns;
  rest_until_ns_ = frame.done_ns + std::min(frame.inference_ns, kLongestRestNs);
  small_in_use_ = small;
  deliver(frame);
  return Status::ok();
}

void Pipeline::deliver(const DepthFrame& frame) {
  last_depth_ns_ = frame.done_ns;
  flowed_ = true;
  for (DepthSink* sink : sinks_) sink->offer(frame);
  health_.note_inferred(frame.meta.sequence, frame.meta.sensor_ns, frame.inference_ns,
                        frame.done_ns);
  if (health_.state() == PipelineState::kStreaming) return;
  health_.set_state(PipelineState::kStreaming);
  set_fault("");
}

// How long without a good frame until something is done about it.
milliseconds Pipeline::patience() const {
  return flowed_ ? options_.no_signal_after : options_.recover_after;
}

// ---- any thread ---------------------------------------------------------------------------------

Pipeline::Source Pipeline::source() const {
  const std::lock_guard lock(mutex_);
  return source_;
}

Pipeline::EngineView Pipeline::engine() const {
  const std::lock_guard lock(mutex_);
  return small_in_use_ ? small_view_ : view_;
}

std::string Pipeline::fault() const {
  const std::lock_guard lock(mutex_);
  return fault_;
}

void Pipeline::set_fault(const char* text) {
  const std::lock_guard lock(mutex_);
  std::snprintf(fault_, sizeof(fault_), "%s", text);
}

}  // namespace lcdm
