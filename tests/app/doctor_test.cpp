// Every look of the doctor at a machine that is made up for it: what is well, what is not, and that
// what is not names its cure.
#include "app/doctor.h"

#include <arpa/inet.h>
#include <filesystem>
#include <fstream>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <string>
#include <sys/socket.h>
#include <unistd.h>

namespace lcdm {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

class Doctor : public testing::Test {
 protected:
  void SetUp() override {
    root_ = testing::TempDir() + "lcdm_doctor_" +
            testing::UnitTest::GetInstance()->current_test_info()->name();
    fs::create_directories(root_);
  }
  void TearDown() override { fs::remove_all(root_); }

  void write(const std::string& path, const std::string& text) const {
    fs::create_directories(fs::path(root_ + path).parent_path());
    std::ofstream(root_ + path) << text;
  }

  std::string root_;
};

void expect(const Finding& finding, Severity severity, const std::string& text) {
  EXPECT_EQ(finding.severity, severity) << finding.text;
  EXPECT_THAT(finding.text, HasSubstr(text));
  EXPECT_EQ(finding.text.find('\n'), std::string::npos) << "one line";
}

V4l2Node usb_camera(float mbps, float version) {
  V4l2Node node;
  node.path = "/dev/video0";
  node.card = "Webcam";
  node.usb_mbps = mbps;
  node.usb_version = version;
  node.usable = true;
  return node;
}

TEST_F(Doctor, SeesACameraOnABusThatIsTooSlowForIt) {
  expect(check_cameras({usb_camera(480, 2)}, "auto")[0], Severity::kOk, "480 Mb/s");
  expect(check_cameras({usb_camera(5000, 3.2F)}, "auto")[0], Severity::kOk, "5000 Mb/s");
  expect(check_cameras({usb_camera(480, 3.2F)}, "auto")[0], Severity::kWarning, "USB 3 cable");
  expect(check_cameras({usb_camera(12, 2)}, "auto")[0], Severity::kWarning, "too slow for video");
}

TEST_F(Doctor, SeesACameraThatMayNotBeOpenedOrIsNotThere) {
  V4l2Node locked;
  locked.reason = "v4l2:/dev/video0: add this user to the group video: Permission denied";
  const auto findings = check_cameras({locked}, "auto");
  ASSERT_EQ(findings.size(), 2U);
  expect(findings[0], Severity::kWarning, "group video");
  expect(findings[1], Severity::kWarning, "rendered scene");
  const auto missing = check_cameras({}, "v4l2:/dev/video99");
  ASSERT_EQ(missing.size(), 1U);
  expect(missing[0], Severity::kFault, "plugged in");
  expect(check_cameras({}, "scene:3")[0], Severity::kOk, "needs none");
}

TEST_F(Doctor, SeesAUsbPortThatMayNotBeReset) {
  V4l2Node camera = usb_camera(480, 2);
  camera.usb = root_;
  expect(check_cameras({camera}, "auto")[1], Severity::kOk, "may be reset");
  camera.usb = root_ + "/001/004";
  expect(check_cameras({camera}, "auto")[1], Severity::kWarning, "a udev rule");
}

TEST_F(Doctor, SaysNothingOfTheMetadataNodeBesideACamera) {
  V4l2Node metadata;
  metadata.reason = "v4l2:/dev/video1 (Webcam): it captures no video";
  EXPECT_EQ(check_cameras({usb_camera(480, 2), metadata}, "auto").size(), 1U);
}

TEST_F(Doctor, SeesARateThatTheCameraCannotReach) {
  CaptureRequest request;
  request.frames_per_second = 30;
  const V4l2Mode fast{V4L2_PIX_FMT_YUYV, 640, 480, 640, 480, {30}};
  const V4l2Mode slow{V4L2_PIX_FMT_YUYV, 640, 480, 640, 480, {15, 10}};
  const V4l2Mode silent{V4L2_PIX_FMT_YUYV, 640, 480, 640, 480, {}};
  const V4l2Mode unknown{V4L2_PIX_FMT_SRGGB10, 640, 480, 640, 480, {30}};
  expect(check_rate({fast}, request), Severity::kOk, "YUYV 640x480 at 30 frames/s");
  expect(check_rate({slow}, request), Severity::kWarning, "15 frames/s, 30 are wanted: set");
  expect(check_rate({silent}, request), Severity::kOk, "lists no rates");
  expect(check_rate({unknown}, request), Severity::kFault, "no format");
}

TEST_F(Doctor, SeesAModelThatIsMissing) {
  Config config;
  config.model.file = "/nowhere.safetensors";
  std::uint64_t bytes = 0;
  expect(check_model(config, bytes), Severity::kFault, "/nowhere.safetensors");
}

TEST_F(Doctor, SeesMemoryThatCannotBeLockedWhereThereIsSwap) {
  constexpr std::uint64_t kMiB = 1U << 20;
  write("/proc/swaps", "Filename Type Size Used Priority\n");
  expect(check_memory_lock(root_, 8 * kMiB, 40 * kMiB), Severity::kOk, "no swap");
  write("/proc/swaps", "Filename Type Size Used Priority\n/dev/sda2 partition 1 0 -2\n");
  expect(check_memory_lock(root_, 8 * kMiB, 40 * kMiB), Severity::kWarning,
         "8 MiB may be locked of 40 MiB, and there is swap: LimitMEMLOCK=infinity");
  expect(check_memory_lock(root_, 64 * kMiB, 40 * kMiB), Severity::kOk, "may be locked");
}

TEST_F(Doctor, SeesADiskThatIsFull) {
  expect(check_disk(root_ + "/not/made/yet", 0), Severity::kOk, root_ + ": ");
  expect(check_disk(root_, 2'000'000'000), Severity::kWarning, "delete old recordings");
  expect(check_disk("/proc/nothing", 0), Severity::kWarning, "set record.directory");
}

TEST_F(Doctor, SeesAPortThatIsTaken) {
  const int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t length = sizeof(address);
  ASSERT_EQ(bind(fd, reinterpret_cast<const sockaddr*>(&address), length), 0);
  ASSERT_EQ(listen(fd, 1), 0);
  ASSERT_EQ(getsockname(fd, reinterpret_cast<sockaddr*>(&address), &length), 0);
  const int port = ntohs(address.sin_port);
  expect(check_port("127.0.0.1", port, true), Severity::kWarning, "is in use");
  close(fd);
  expect(check_port("127.0.0.1", port, true), Severity::kOk, "is free");
  expect(check_port("192.0.2.1", port, false), Severity::kWarning, "lacks that address");
  expect(check_port("192.0.2.1", port, true), Severity::kFault, "choose another http.listen");
}

TEST_F(Doctor, SeesAClockThatNobodySets) {
  expect(check_clock(true), Severity::kOk, "synchronised");
  expect(check_clock(false), Severity::kWarning, "timedatectl");
}

TEST_F(Doctor, SeesAWatchdogThatSleeps) {
  expect(check_hardware_watchdog(root_), Severity::kWarning, "none");
  write("/sys/class/watchdog/watchdog0/identity", "i6300ESB timer\n");
  write("/sys/class/watchdog/watchdog0/state", "inactive\n");
  expect(check_hardware_watchdog(root_), Severity::kWarning, "i6300ESB timer is idle: Runtime");
  write("/sys/class/watchdog/watchdog0/state", "active\n");
  expect(check_hardware_watchdog(root_), Severity::kOk, "i6300ESB timer is active");
}

TEST_F(Doctor, SeesAServiceThatNobodyWatches) {
  expect(check_service(root_), Severity::kWarning, "not installed");
  write("/lib/systemd/system/lcdm.service", "[Service]\nType=notify\n");
  expect(check_service(root_), Severity::kWarning, "WatchdogSec= is missing");
  write("/lib/systemd/system/lcdm.service", "[Service]\nType=notify\nWatchdogSec=10\n");
  expect(check_service(root_), Severity::kOk, "WatchdogSec=10");
}

TEST_F(Doctor, SeesGpioChips) {
  expect(check_gpio(root_), Severity::kWarning, "none");
  write("/dev/gpiochip0", "");
  expect(check_gpio(root_), Severity::kOk, "/dev/gpiochip0");
}

}  // namespace
}  // namespace lcdm
