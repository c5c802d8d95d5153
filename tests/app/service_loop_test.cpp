// The supervising loop on main: what it does, says and ends with when the camera misbehaves.
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <string>
#include <thread>
#include <unistd.h>

#include "app/report.h"
#include "app/status_json.h"
#include "firmware/base/exit_code.h"
#include "tests/app/service_fixture.h"
#include "tests/support/locked_memory_limit.h"
#include "tests/support/notify_socket.h"

namespace lcdm {
namespace {

using std::chrono::milliseconds;
using testing::HasSubstr;

// Heard as systemd hears it.
class ServiceLoopTest : public test::InnerServiceTest {
 protected:
  ServiceLoopTest() {
    setenv("NOTIFY_SOCKET", systemd_.path().c_str(), 1);
    // What ends the process runs in one of its own, not in a fork of this one's threads.
    testing::GTEST_FLAG(death_test_style) = "threadsafe";
  }
  ~ServiceLoopTest() override { unsetenv("NOTIFY_SOCKET"); }

  // Runs until the script ends it; gives what it said to the log.
  Status run() {
    testing::internal::CaptureStdout();
    Status status = service_->start(signals_);
    if (status) status = service_->run(signals_);
    log_ = testing::internal::GetCapturedStdout();
    return status;
  }
  void run_until_it_streams() {
    make();
    camera_.on_dequeue = [this](int) {
      return service_->status().judgement.state == DeviceState::kStreaming
                 ? Status::error(StatusCode::kEndOfStream, "fake: the end")
                 : Status::ok();
    };
    EXPECT_TRUE(run());
    TearDown();
  }
  // With two networks, until the smaller one infers: the script ends there, or after frames enough.
  void run_until_the_smaller_network(const Config& config = {}) {
    make({}, test::tiny_engine(96), test::tiny_engine(64), config);
    camera_.on_dequeue = [this](int call) {
      const bool small = pipeline_->engine().stats.width == 64;
      return call < 60'000 && !small ? Status::ok()
                                     : Status::error(StatusCode::kEndOfStream, "fake: the end");
    };
    EXPECT_TRUE(run());
    EXPECT_EQ(pipeline_->engine().stats.width, 64);
  }
  // The message that begins so; empty when there is none.
  std::string message(const std::string& start) {
    std::string text;
    while (!(text = systemd_.next(0)).empty() && text.rfind(start, 0) != 0) continue;
    return text;
  }

  const StopSignals signals_;
  test::NotifySocket systemd_{folder_.file("notify")};
  std::string log_;
};

TEST_F(ServiceLoopTest, WarnsAtTheStartWhereTheKernelGivesNoHugePages) {
  const auto warned = [&](const std::string& enabled) {
    const std::filesystem::path folder = sysfs() + "/kernel/mm/transparent_hugepage";
    std::filesystem::create_directories(folder);
    std::ofstream(folder / "enabled") << enabled << "\n";
    run_until_it_streams();
    return log_.find("warning: no huge pages") != std::string::npos;
  };
  EXPECT_TRUE(warned("always madvise [never]"));
  EXPECT_FALSE(warned("always [madvise] never"));
}

#ifndef LCDM_SANITIZED  // there nothing is locked
TEST_F(ServiceLoopTest, WarnsAtTheStartThatTheNetworkMayBeSwappedOut) {
  const auto warned = [&] {
    run_until_it_streams();
    return log_.find("warning: its weights and activations may be swapped out") !=
           std::string::npos;
  };
  EXPECT_FALSE(warned());
  const auto within_limit = [&] {
    test::limit_locked_memory(4096);
    _exit(warned() ? 0 : 1);
  };
  EXPECT_EXIT(within_limit(), testing::ExitedWithCode(0), "");
}
#endif

// The light blinks with what the status says.
TEST_F(ServiceLoopTest, ShowsThatItBootsWhileTheEngineIsMade) {
  bool looked = false;
  make({},
       [&](const FrameFormat&, const CameraModel&,
           const Pipeline::Alive&) -> Result<std::unique_ptr<Engine>> {
         const std::int64_t begin_ns = os::monotonic_ns();
         while (!looked && os::monotonic_ns() - begin_ns < 60'000'000'000) {
           looked = service_->status().looked_ns > begin_ns;
           std::this_thread::sleep_for(milliseconds(5));
         }
         EXPECT_EQ(service_->status().judgement.state, DeviceState::kBooting);
         return Status::error(StatusCode::kInvalidInput, "fake: no such size");
       });
  EXPECT_EQ(run().code(), StatusCode::kInvalidInput);
  EXPECT_TRUE(looked);
}

TEST_F(ServiceLoopTest, ASignalEndsAStartThatADriverHolds) {
  camera_.on_configure = [](int) {
    std::this_thread::sleep_for(milliseconds(60'000));
    return Status::ok();
  };
  make();
  const auto start = [this] {
    raise(SIGTERM);
    static_cast<void>(service_->start(signals_));
  };
  EXPECT_EXIT(start(), testing::ExitedWithCode(kExitOk), "");
}

// The camera fails, and the driver does not come back from opening it again.
TEST_F(ServiceLoopTest, ADriverThatHoldsRecoveryDoesNotHoldTheEnd) {
  camera_.on_configure = [](int call) {
    if (call > 0) std::this_thread::sleep_for(milliseconds(60'000));
    return Status::ok();
  };
  camera_.on_start = [](int call) {
    return call == 0 ? Status::ok() : Status::error(StatusCode::kIoError, "fake: EIO");
  };
  camera_.on_dequeue = [](int) { return Status::error(StatusCode::kIoError, "fake: EIO"); };
  make();
  const auto end = [this] {
    if (!pipeline_->start()) return;
    while (camera_.configured < 2) std::this_thread::sleep_for(milliseconds(1));
    service_->end(kExitFailure);
  };
  EXPECT_EXIT(end(), testing::ExitedWithCode(kExitFailure), "");
}

TEST_F(ServiceLoopTest, ASignalDuringTheStartIsHeardAfterIt) {
  camera_.on_configure = [](int) {
    kill(getpid(), SIGTERM);
    std::this_thread::sleep_for(milliseconds(100));
    return Status::ok();
  };
  make();
  EXPECT_TRUE(run());
  EXPECT_THAT(message("STOPPING=1"), HasSubstr("stopping"));
}

// The end of a recording waits for the disk, which may hang.
TEST_F(ServiceLoopTest, ALongPressAsksForPowerOffBeforeTheRecordingEnds) {
  make();
  ASSERT_TRUE(pipeline_->start());
  ASSERT_TRUE(start_recording(*pipeline_, recorder_));
  setenv("RUNTIME_DIRECTORY", folder_.path().c_str(), 1);
  ButtonControl(*pipeline_, recorder_).press(Press::kLong);
  unsetenv("RUNTIME_DIRECTORY");
  EXPECT_TRUE(std::filesystem::exists(folder_.file("poweroff")));
  EXPECT_TRUE(recorder_.status().recording);
}

// A stream that fails once, then a camera that is away for some tries, then the end of the script.
TEST_F(ServiceLoopTest, EveryStepOfTheLadderIsALineOfTheLogUnlessItIsTheLastOneAgain) {
  camera_.on_dequeue = [](int call) {
    if (call == 30) return Status::error(StatusCode::kIoError, "fake: EIO");
    if (call == 60) return Status::error(StatusCode::kDeviceGone, "fake: unplugged");
    return call < 90 ? Status::ok() : Status::error(StatusCode::kEndOfStream, "fake: the end");
  };
  camera_.on_configure = [](int call) {
    return call == 0 || call > 3 ? Status::ok()
                                 : Status::error(StatusCode::kNotFound, "fake: away");
  };
  PipelineOptions options;  // each step takes long enough for a busy machine to look
  options.recovery.first_backoff = options.recovery.last_backoff = milliseconds(500);
  make(options);
  EXPECT_TRUE(run());
  EXPECT_THAT(log_, HasSubstr("recovery: stream restart: fake: EIO\n"));
  const std::size_t wait = log_.find("recovery: wait for device: fake: unplugged\n");
  ASSERT_NE(wait, std::string::npos) << log_;
  const std::size_t reason = log_.find("recovery: wait for device: fake: away\n", wait);
  ASSERT_NE(reason, std::string::npos) << log_;
  EXPECT_EQ(log_.find("recovery: ", reason + 1), std::string::npos) << log_;
}

TEST_F(ServiceLoopTest, APageThatDoesNotAnswerDegradesTheDevice) {
  camera_.on_dequeue = [](int call) {
    return call < 300 ? Status::ok() : Status::error(StatusCode::kEndOfStream, "fake: the end");
  };
  make();
  Heartbeat page;
  page.beat(os::monotonic_ns() - 20'000'000'000);
  service_->watch_page(page);
  EXPECT_TRUE(run());
  EXPECT_THAT(log_, HasSubstr("degraded: thread page gives no sign of life"));
}

// No network gives ten thousand depths a second.
TEST_F(ServiceLoopTest, ANetworkThatIsTooSlowGivesWayToTheSmallerOne) {
  Config config;
  config.service.least_rate = 10'000;
  run_until_the_smaller_network(config);
  EXPECT_THAT(log_, HasSubstr("degraded: smaller network: the network is slower"));
}

// Two degrees below where the system would hold the processor back.
TEST_F(ServiceLoopTest, HeatGivesWayToTheSmallerNetworkToo) {
  const std::filesystem::path zone = sysfs() + "/class/thermal/thermal_zone0";
  std::filesystem::create_directories(zone);
  std::ofstream(zone / "type") << "cpu-thermal\n";
  std::ofstream(zone / "temp") << "93000\n";
  std::ofstream(zone / "trip_point_0_type") << "passive\n";
  std::ofstream(zone / "trip_point_0_temp") << "95000\n";
  run_until_the_smaller_network();
  EXPECT_THAT(log_, HasSubstr("degraded: smaller network: the board is hot"));
}

TEST_F(ServiceLoopTest, TheLastRungEndsTheProcessSoThatSystemdStartsAnother) {
  camera_.on_dequeue = [](int) { return Status::error(StatusCode::kIoError, "fake: EIO"); };
  PipelineOptions options;
  options.recovery.give_up_after = milliseconds(0);
  make(options);
  const Status status = run();
  EXPECT_EQ(report(status), kExitFailure) << "which systemd restarts";
  EXPECT_THAT(log_, HasSubstr("fault: nothing brings the camera back: fake: EIO"));
  EXPECT_THAT(message("STOPPING=1"), HasSubstr("restart: nothing brings the camera back"));
}

// It ends with the process, so it would be 0 for ever: systemd's NRestarts counts.
TEST_F(ServiceLoopTest, TheStatusHasNoCountThatNobodyCanSee) {
  make();
  const auto status = status_json(*pipeline_, recorder_.status(), service_->status(), 0, 0);
  EXPECT_TRUE(status["recovery"].contains("port_resets"));
  EXPECT_FALSE(status["recovery"].contains("process_restarts"));
}

}  // namespace
}  // namespace lcdm
