// From camera to sinks: two threads and one hand-off. Read pipeline.cpp from the top.
#pragma once

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/buffer/frame_pool.h"
#include "firmware/buffer/mailbox.h"
#include "firmware/health/degrade_ladder.h"
#include "firmware/health/health.h"
#include "firmware/nn/engine.h"
#include "firmware/pipeline/camera.h"
#include "firmware/pipeline/camera_port.h"
#include "firmware/pipeline/depth_sink.h"
#include "firmware/pipeline/frame_decoder.h"
#include "firmware/pipeline/recovery_ladder.h"

namespace lcdm {

struct PipelineOptions {
  CaptureRequest request;
  // False for sources whose library allocates per frame (files, recordings): the capture thread
  // then stays outside the promise not to allocate.
  bool seal_capture = true;
  // How long without a frame until the state says `no signal`; from a camera that has given depth
  // since it was started, until something is done about it, too. With a restart depth is back
  // within 2 s. Never less than three of the camera's frame periods, like the next.
  std::chrono::milliseconds no_signal_after{1200};
  // The same for one that has given none yet: many take a second or two to their first frame.
  std::chrono::milliseconds recover_after{2500};
  RecoveryOptions recovery;
  // Where the camera is plugged in; borrowed. Null: it is nothing that comes and goes, and one that
  // is missing or fails is an error of start.
  CameraPort* port = nullptr;
};

// Threads: the owner calls the constructor, start and stop, one after the other. `capture` is the
// only caller of the camera after start. `infer` decodes, runs the engine and calls the sinks. The
// rest is for any thread.
class Pipeline {
 public:
  // What a factory calls between its steps, each of which may take a slow board seconds: the infer
  // thread does not hang.
  using Alive = std::function<void()>;
  // Makes the engine for a camera. Called by start, and on the infer thread when a camera comes
  // back with another format or model.
  using EngineFactory = std::function<Result<std::unique_ptr<Engine>>(
      const FrameFormat&, const CameraModel&, const Alive&)>;

  // What the camera says about itself.
  struct Source {
    CameraInfo info;
    FrameFormat format;
    CameraModel model;
  };

  // What the engine says about itself.
  struct EngineView {
    EngineStats stats;
    CameraModel depth_camera;
    ScaleKind scale = ScaleKind::kRelative;
  };

  // The camera, the decoder (null: the source is never compressed) and the sinks are borrowed and
  // must outlive the pipeline. `make_small_engine` makes the one for less effort; where there is
  // none, or it gives null, the only engine goes on with it.
  Pipeline(Camera& camera, EngineFactory make_engine, FrameDecoder* decoder,
           std::vector<DepthSink*> sinks, const PipelineOptions& options,
           EngineFactory make_small_engine = nullptr);
  ~Pipeline() { stop(); }
  Pipeline(const Pipeline&) = delete;
  Pipeline& operator=(const Pipeline&) = delete;

  // Opens the camera, prepares everything, starts the threads. A camera with a port that is not
  // plugged in is waited for (the state is then kNoCamera), and one that fails is brought back like
  // any other (kNoSignal); where it could not be opened the engine is prepared when it can. What
  // only another start can cure is an error: a format that nobody knows, an engine that cannot be
  // made. On error nothing runs. Once only.
  Status start();
  // Ends and joins both threads: after the frame in work, within one dequeue time-out, and when the
  // driver that recovery waits for gives the camera back. Again is harmless.
  void stop();

  // How much work goes into depth, from the next frame on. Any thread.
  void set_effort(Effort effort) { effort_ = effort; }

  // Whether less effort has a network of its own; false: the only engine goes on with it. Until the
  // first engine is made, whether one is to be.
  bool has_small_engine() const { return has_small_engine_; }

  const Health& health() const { return health_; }
  Source source() const;
  EngineView engine() const;
  // Why the newest fault happened, for the status; empty when all is well.
  std::string fault() const;

 private:
  struct Captured {
    FrameRef frame;
    std::uint64_t generation = 0;  // of the source that gave it
  };

  // Capture thread (and start, before it exists).
  void capture_loop(const Status& opened);
  void forward(const CapturedFrame& captured);
  void note_stamp(StampSource stamp);
  Status give_back_returned();
  void stop_camera();
  void wait_until_nothing_is_lent();
  Status configure_camera();

  // Capture thread: what no frame means, and the way back to frames (pipeline_recovery.cpp). False:
  // the capture thread's work is over.
  bool survive(const Status& status);
  bool judge_silence(const Status& status);
  bool judge_depth();
  bool recover(Status fault);
  bool wait_before(const RecoveryStep& step);
  Status climb_alive(RecoveryRung rung);
  Status climb(RecoveryRung rung);  // on a thread of its own
  void reset_port();
  void declare(const Status& fault);

  // Infer thread (and start, before it exists).
  void infer_loop();
  void follow_source(std::uint64_t generation);
  Status prepare_engine(const Source& source);
  Status make_engines(const FrameFormat& pixels, const CameraModel& model);
  bool resting() const;
  Status infer(const FrameView& captured);
  void deliver(const DepthFrame& frame);
  void note_fault(const Status& status);

  std::chrono::milliseconds patience() const;  // capture, infer
  void set_fault(const char* text);

  Camera& camera_;
  const EngineFactory make_engine_;
  const EngineFactory make_small_engine_;
  FrameDecoder* const decoder_;
  const std::vector<DepthSink*> sinks_;
  const PipelineOptions options_;

  std::atomic<bool> stopping_{false};
  std::atomic<Effort> effort_{Effort::kFull};
  std::atomic<bool> small_in_use_{false};  // for the newest depth; written by infer
  std::atomic<bool> has_small_engine_;     // written by infer
  Health health_;
  Mailbox<Captured> mailbox_;
  std::optional<FramePool> pool_;  // capture thread; replaced only while nothing is lent
  RecoveryLadder ladder_;          // capture thread
  std::uint64_t generation_ = 0;   // capture thread; counts openings
  StampSource stamp_ = StampSource::kArrival;     // capture thread; what source_ says
  std::int64_t last_frame_ns_ = 0;                // capture thread
  std::int64_t seen_depth_ns_ = 0;                // capture thread; the depth that the ladder knows
  std::chrono::milliseconds three_periods_{100};  // capture thread; of the camera's frames

  std::unique_ptr<Engine> engine_;              // infer thread; null: none for this source
  std::unique_ptr<Engine> small_engine_;        // infer thread; null: engine_ stands in
  Status engine_status_;                        // infer thread; why there is none
  std::int64_t rest_until_ns_ = 0;              // infer thread
  std::atomic<std::int64_t> last_depth_ns_{0};  // written by the infer thread
  // Depth has come since the camera was started. Set by infer, taken back by capture.
  std::atomic<bool> flowed_{false};
  // Set by infer, taken by capture: no frame can be decoded.
  std::atomic<bool> only_corrupt_{false};
  std::vector<std::uint16_t> millimetres_;  // infer thread; [height * width] of depth
  FrameFormat prepared_format_;             // infer thread; the camera's, before decoding
  CameraModel prepared_model_;              // infer thread
  std::uint64_t prepared_generation_ = 0;   // infer thread

  mutable std::mutex mutex_;  // guards what follows
  Source source_;
  EngineView view_;
  EngineView small_view_;
  char fault_[Status::kMaxText] = {};

  std::thread capture_thread_;
  std::thread infer_thread_;
};

}  // namespace lcdm
