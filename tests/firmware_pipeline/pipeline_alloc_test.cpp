// The promise not to allocate, kept over 500 frames: in this program an allocation in a sealed
// thread aborts.
#include <atomic>
#include <chrono>
#include <gtest/gtest.h>
#include <thread>
#include <vector>

#include "drivers/scene/camera.h"
#include "firmware/base/alloc_watch.h"
#include "firmware/pipeline/pipeline.h"
#include "tests/firmware_pipeline/fake_camera.h"
#include "tests/firmware_pipeline/tiny_engine.h"

namespace lcdm {
namespace {

using std::chrono::milliseconds;

class CountingSink final : public DepthSink {
 public:
  void offer(const DepthFrame&) noexcept override { ++count; }
  std::atomic<int> count{0};
};

// Allocates for every frame, against the rules.
class AllocatingSink final : public DepthSink {
 public:
  void offer(const DepthFrame& frame) noexcept override {
    kept_.emplace_back(1000 + frame.meta.sequence);
  }

 private:
  std::vector<std::vector<char>> kept_;
};

TEST(PipelineAllocations, FiveHundredFramesOfTheSceneTakeNone) {
  ASSERT_TRUE(alloc_watch::hooked());
  alloc_watch::abort_on_sealed_allocation();
  SceneCamera camera(1);
  CountingSink sink;
  PipelineOptions options;
  options.request = {96, 64, 400, 65, {}};
  Pipeline pipeline(camera, test::tiny_engine(), nullptr, {&sink}, options);
  const Status status = pipeline.start();
  ASSERT_TRUE(status.is_ok()) << status.text();
  for (int i = 0; i < 6000 && sink.count < 500; ++i) {
    std::this_thread::sleep_for(milliseconds(10));
  }
  EXPECT_GE(sink.count, 500);
  pipeline.stop();
  EXPECT_EQ(alloc_watch::sealed_allocations(), 0U);
}

void run_with_an_allocating_sink() {
  alloc_watch::abort_on_sealed_allocation();
  test::FakeCamera camera;
  AllocatingSink sink;
  Pipeline pipeline(camera, test::tiny_engine(), nullptr, {&sink}, {});
  static_cast<void>(pipeline.start());
  std::this_thread::sleep_for(milliseconds(5000));
}

TEST(PipelineAllocationsDeathTest, AnAllocationInASealedThreadEndsTheProgram) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_DEATH(run_with_an_allocating_sink(), "allocation in the sealed thread infer");
}

}  // namespace
}  // namespace lcdm
