// The service inside the test's own process, on a camera that does what the test's script says.
#pragma once

#include <chrono>
#include <gtest/gtest.h>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "app/service.h"
#include "tests/firmware_pipeline/fake_camera.h"
#include "tests/firmware_pipeline/tiny_engine.h"
#include "tests/support/temporary_folder.h"

namespace lcdm::test {

class InnerServiceTest : public testing::Test {
 protected:
  // Call it once, when the camera has its script and sysfs() its files.
  void make(const PipelineOptions& options = {}, Pipeline::EngineFactory engine = tiny_engine(),
            Pipeline::EngineFactory small_engine = nullptr, const Config& config = {}) {
    pipeline_ = std::make_unique<Pipeline>(camera_, std::move(engine), nullptr,
                                           std::vector<DepthSink*>{&view_, &recorder_}, options,
                                           std::move(small_engine));
    service_ = std::make_unique<Service>(*pipeline_, view_, recorder_, config, sysfs());
  }
  // Without files: a board that has no sensors.
  std::string sysfs() const { return folder_.file("sys"); }
  void TearDown() override {
    view_.stop();
    if (pipeline_) pipeline_->stop();
  }

  TemporaryFolder folder_;
  FakeCamera camera_;
  LiveView view_{"fake:"};
  Recorder recorder_{{folder_.file("recordings"), 256LL << 20, 0}};
  std::unique_ptr<Pipeline> pipeline_;
  std::unique_ptr<Service> service_;
};

}  // namespace lcdm::test
