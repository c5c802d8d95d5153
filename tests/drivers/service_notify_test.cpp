// What systemd would hear, on a socket of the kind it makes.
#include "drivers/service_notify.h"

#include <cstdlib>
#include <gtest/gtest.h>
#include <string>
#include <unistd.h>

#include "tests/support/notify_socket.h"
#include "tests/support/temporary_folder.h"

namespace lcdm {
namespace {

class ServiceNotifyTest : public testing::Test {
 protected:
  void SetUp() override { setenv("NOTIFY_SOCKET", socket_.path().c_str(), 1); }
  void TearDown() override {
    for (const char* name : {"NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"}) unsetenv(name);
  }

  test::TemporaryFolder folder_;
  test::NotifySocket socket_{folder_.file("notify")};
};

TEST_F(ServiceNotifyTest, SaysWhatSystemdReads) {
  const ServiceNotify notify;
  EXPECT_TRUE(notify.listened());
  notify.status("booting");
  notify.ready("streaming, 12.3 depths/s");
  notify.ping();
  notify.stopping("stopping");
  EXPECT_EQ(socket_.next(), "STATUS=booting");
  EXPECT_EQ(socket_.next(), "READY=1\nSTATUS=streaming, 12.3 depths/s");
  EXPECT_EQ(socket_.next(), "WATCHDOG=1");
  EXPECT_EQ(socket_.next(), "STOPPING=1\nSTATUS=stopping");
}

TEST_F(ServiceNotifyTest, AReasonCannotForgeAnotherMessage) {
  ServiceNotify().status("waiting: caf\xe9\nMAINPID=1");
  EXPECT_EQ(socket_.next(), "STATUS=waiting: caf??MAINPID=1");
}

TEST_F(ServiceNotifyTest, TheWatchdogIsOursOrNone) {
  EXPECT_EQ(ServiceNotify().watchdog_ns(), 0);
  setenv("WATCHDOG_USEC", "2000000", 1);
  EXPECT_EQ(ServiceNotify().watchdog_ns(), 2'000'000'000);
  setenv("WATCHDOG_PID", std::to_string(getpid()).c_str(), 1);
  EXPECT_EQ(ServiceNotify().watchdog_ns(), 2'000'000'000);
  setenv("WATCHDOG_PID", "1", 1);
  EXPECT_EQ(ServiceNotify().watchdog_ns(), 0) << "another process is watched";
}

TEST_F(ServiceNotifyTest, OutsideSystemdNothingIsSent) {
  unsetenv("NOTIFY_SOCKET");
  setenv("WATCHDOG_USEC", "2000000", 1);
  const ServiceNotify notify;
  EXPECT_FALSE(notify.listened());
  EXPECT_EQ(notify.watchdog_ns(), 0) << "a watchdog that cannot hear us";
  notify.ready("streaming");
  notify.ping();
  EXPECT_EQ(socket_.next(0), "");
}

TEST_F(ServiceNotifyTest, AListenerThatLeftIsNotWaitedFor) {
  setenv("NOTIFY_SOCKET", "/nowhere/notify", 1);
  const ServiceNotify notify;
  notify.ready("streaming");
  notify.ping();
}

}  // namespace
}  // namespace lcdm
