// Every look of the doctor at a machine that is made up for it: what is well, what is not, and that
// what is not names its cure.
#include "app/doctor.h"

#include <algorithm>
#include <arpa/inet.h>
#include <cerrno>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <limits>
#include <netinet/in.h>
#include <string>
#include <sys/socket.h>
#include <sys/stat.h>
#include <thread>
#include <unistd.h>

#include "app/doctor_camera.h"
#include "app/doctor_machine.h"
#include "app/doctor_rate.h"
#include "app/http_server.h"
#include "tests/firmware_pipeline/fake_camera.h"
#include "tests/support/temporary_folder.h"

namespace lcdm {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

class Doctor : public testing::Test {
 protected:
  // As the root of a machine, others may look into it.
  void SetUp() override { fs::permissions(root_, fs::perms(0755)); }

  void write(const std::string& path, const std::string& text) const {
    fs::create_directories(fs::path(root_ + path).parent_path());
    std::ofstream(root_ + path) << text;
  }

  test::TemporaryFolder folder_;
  const std::string root_ = folder_.path();
};

void expect(const Finding& finding, Severity severity, const std::string& text) {
  EXPECT_EQ(finding.severity, severity) << finding.text;
  EXPECT_THAT(finding.text, HasSubstr(text));
  EXPECT_EQ(finding.text.find('\n'), std::string::npos) << "one line";
}

const Account kCaller = calling_account();

// Somebody who is neither us nor in any group.
Account stranger() {
  Account account;
  account.name = "the service's account lcdm";
  account.is_caller = false;
  account.user = 65'534;
  return account;
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
  expect(check_cameras({usb_camera(480, 2)}, "auto", kCaller)[0], Severity::kOk, "480 Mb/s");
  expect(check_cameras({usb_camera(5000, 3.2F)}, "auto", kCaller)[0], Severity::kOk, "5000 Mb/s");
  expect(check_cameras({usb_camera(480, 3.2F)}, "auto", kCaller)[0], Severity::kWarning,
         "USB 3 cable");
  expect(check_cameras({usb_camera(12, 2)}, "auto", kCaller)[0], Severity::kWarning,
         "too slow for video");
}

TEST_F(Doctor, SeesACameraThatMayNotBeOpenedOrIsNotThere) {
  V4l2Node locked;
  locked.reason = "v4l2:/dev/video0: add this user to the group video: Permission denied";
  const auto findings = check_cameras({locked}, "auto", kCaller);
  ASSERT_EQ(findings.size(), 2U);
  expect(findings[0], Severity::kWarning, "group video");
  expect(findings[1], Severity::kWarning, "rendered scene");
  const auto missing = check_cameras({}, "v4l2:/dev/video99", kCaller);
  ASSERT_EQ(missing.size(), 1U);
  expect(missing[0], Severity::kFault, "plugged in");
  expect(check_cameras({}, "scene:3", kCaller)[0], Severity::kOk, "needs none");
}

TEST_F(Doctor, SeesACameraThatLibcameraDoesNotKnow) {
  expect(check_libcamera("libcamera:A", {"B", "A"}), Severity::kOk, "knows it");
  expect(check_libcamera("libcamera:C", {"B", "A"}), Severity::kFault, "knows B, A: set camera");
  expect(check_libcamera("libcamera:C", {}), Severity::kFault, "knows no camera");
  const auto findings = check_cameras({}, "libcamera:NOSUCH", kCaller);
  ASSERT_EQ(findings.size(), 1U);
  expect(findings[0], Severity::kFault, "libcamera:NOSUCH");
}

TEST_F(Doctor, SeesAUsbPortThatMayNotBeReset) {
  V4l2Node camera = usb_camera(480, 2);
  camera.usb = root_;
  expect(check_cameras({camera}, "auto", kCaller)[1], Severity::kOk, "may be reset");
  camera.usb = root_ + "/001/004";
  expect(check_cameras({camera}, "auto", kCaller)[1], Severity::kWarning, "a udev rule");
}

TEST_F(Doctor, SaysNothingOfTheMetadataNodeBesideACamera) {
  V4l2Node metadata;
  metadata.reason = "v4l2:/dev/video1 (Webcam): it captures no video";
  EXPECT_EQ(check_cameras({usb_camera(480, 2), metadata}, "auto", kCaller).size(), 1U);
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

TEST_F(Doctor, SeesFramesThatDoNotComeAsOftenAsTheyShould) {
  expect(check_arrivals(24.5F, 30), Severity::kOk, "24.5 frames/s come of 30");
  expect(check_arrivals(15.1F, 30), Severity::kWarning, "15.1 frames/s come of 30: give it more");
  expect(check_arrivals(Status::error(StatusCode::kTimeout, "no frame comes"), 30),
         Severity::kFault, "no frame comes");
  expect(check_arrivals(Status::error(StatusCode::kUnavailable, "another program holds it"), 30),
         Severity::kOk, "not measured: another program holds it");
}

TEST_F(Doctor, CountsTheFramesThatComeInATrial) {
  test::FakeCamera camera;
  camera.on_dequeue = [](int) {
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
    return Status::ok();
  };
  const Result<float> rate = measure_rate(camera, {});
  ASSERT_TRUE(rate) << rate.status().text();
  EXPECT_LT(*rate, 20) << "whatever it says of itself";
  EXPECT_GT(*rate, 5);
  EXPECT_FALSE(camera.running) << "it is free again";
}

TEST_F(Doctor, SaysWhyATrialGaveNoRate) {
  test::FakeCamera silent;
  silent.on_dequeue = [](int) { return Status::error(StatusCode::kTimeout, "no frame in time"); };
  EXPECT_EQ(measure_rate(silent, {}).code(), StatusCode::kTimeout);
  EXPECT_FALSE(silent.running);
  test::FakeCamera held;
  held.on_configure = [](int) { return Status::system(EBUSY, "held"); };
  EXPECT_EQ(measure_rate(held, {}).status().sys_errno(), EBUSY);
}

// Ten frames and half a second more at each look.
TEST_F(Doctor, AsksTheServiceThatHoldsTheCameraForItsRate) {
  int looks = 0;
  const auto serve = [&looks](HttpExchange& exchange) {
    ++looks;
    const std::string status = R"({"source": {"uri": "v4l2:any"}, "frames": {"captured": )" +
                               std::to_string(10 * looks) + R"(}, "uptime_s": )" +
                               std::to_string(0.5 * looks) + "}";
    exchange.send_text(200, "application/json", status);
  };
  HttpOptions options;
  options.listen = {"127.0.0.1"};
  auto server = HttpServer::start(options, {{"/status.json", "GET", HttpStay::kShort, serve}});
  ASSERT_TRUE(server) << server.status().text();
  Config config;
  config.http.port = (*server)->port();
  const Result<float> rate = served_rate(config, "v4l2:any");
  ASSERT_TRUE(rate) << rate.status().text();
  EXPECT_FLOAT_EQ(*rate, 20);
  EXPECT_EQ(served_rate(config, "v4l2:/dev/video7").code(), StatusCode::kUnavailable)
      << "it has another camera";
  (*server)->stop();
  EXPECT_EQ(served_rate(config, "v4l2:any").code(), StatusCode::kUnavailable) << "nobody answers";
}

TEST_F(Doctor, SeesAModelThatIsMissing) {
  Config config;
  config.model.file = "/nowhere.safetensors";
  std::uint64_t bytes = 0;
  expect(check_model(config, bytes), Severity::kFault, "/nowhere.safetensors");
}

TEST_F(Doctor, SeesMemoryThatCannotBeLockedWhereThereIsSwap) {
  constexpr std::uint64_t kMiB = 1U << 20;
  Account account;
  account.memory_lock_bytes = 8 * kMiB;
  write("/proc/swaps", "Filename Type Size Used Priority\n");
  expect(check_memory_lock(root_, account, 40 * kMiB), Severity::kOk, "no swap");
  write("/proc/swaps", "Filename Type Size Used Priority\n/dev/sda2 partition 1 0 -2\n");
  expect(check_memory_lock(root_, account, 40 * kMiB), Severity::kWarning,
         "this user may lock only 8 MiB of 40 MiB, and there is swap: LimitMEMLOCK=infinity");
  account.memory_lock_bytes = 64 * kMiB;
  expect(check_memory_lock(root_, account, 40 * kMiB), Severity::kOk, "may lock");
}

TEST_F(Doctor, SeesADiskThatIsFull) {
  expect(check_disk(root_ + "/not/made/yet", 0, kCaller), Severity::kOk, root_ + ": ");
  expect(check_disk(root_, 2'000'000'000, kCaller), Severity::kWarning, "delete old recordings");
  expect(check_disk("/proc/nothing", 0, kCaller), Severity::kWarning, "set record.directory");
}

TEST_F(Doctor, JudgesTheServicesAccountWhereThatIsInstalled) {
  write("/lib/systemd/system/lcdm.service",
        "[Service]\nUser=nobody\nWorkingDirectory=/var/lib/lcdm\nLimitMEMLOCK=8M\n"
        "SupplementaryGroups=root\n");
  write("/etc/systemd/system/lcdm.service.d/override.conf",
        "# laid over it\n[Service]\nLimitMEMLOCK=infinity\nSupplementaryGroups=root\n");
  const auto account = service_account(read_service_unit(root_));
  ASSERT_TRUE(account) << account.status().text();
  EXPECT_EQ(account->name, "the service's account nobody");
  EXPECT_FALSE(account->is_caller);
  EXPECT_EQ(std::count(account->groups.begin(), account->groups.end(), 0U), 2) << "they add up";
  EXPECT_EQ(account->memory_lock_bytes, std::numeric_limits<std::uint64_t>::max());

  Config config;
  config.camera.source = "file:drive.mp4";
  config.http.token_file = "/etc/lcdm/token";
  config = as_seen_by(*account, config);
  EXPECT_EQ(config.record.directory, "/var/lib/lcdm/recordings");
  EXPECT_EQ(config.camera.source, "file:/var/lib/lcdm/drive.mp4");
  EXPECT_EQ(config.http.token_file, "/etc/lcdm/token");
  EXPECT_EQ(config.camera.calibration, "") << "none is none";
}

TEST_F(Doctor, ReadsTheLimitOfLockedMemoryAsSystemdWritesIt) {
  ServiceUnit unit;
  const auto limit = [&unit](const char* text) {
    unit.settings = {{"LimitMEMLOCK", text}};
    return service_account(unit)->memory_lock_bytes;
  };
  EXPECT_EQ(limit("65536"), 65'536U);
  EXPECT_EQ(limit("64M:1G"), 64U << 20) << "the soft one";
  EXPECT_EQ(limit("2G"), 2U << 30);
  EXPECT_EQ(limit(""), 8U << 20) << "systemd's own";
}

TEST_F(Doctor, SeesAServiceWithoutItsAccount) {
  write("/lib/systemd/system/lcdm.service", "[Service]\nUser=no-such-user\n");
  const auto account = service_account(read_service_unit(root_));
  EXPECT_EQ(account.code(), StatusCode::kNotFound);
  EXPECT_THAT(account.status().text(), HasSubstr("User=no-such-user is nobody"));
}

TEST_F(Doctor, AnAccountMayWhatOwnerGroupsModeAndEveryFolderOnTheWayLetIt) {
  write("/folder/file", "");
  const fs::path folder = root_ + "/folder";
  struct stat facts {};
  ASSERT_EQ(stat(folder.c_str(), &facts), 0);
  Account account = stranger();
  const auto may_read = [&](unsigned folder_mode, unsigned file_mode) {
    fs::permissions(folder, static_cast<fs::perms>(folder_mode));
    fs::permissions(folder / "file", static_cast<fs::perms>(file_mode));
    return account.may(folder / "file", R_OK);
  };
  EXPECT_TRUE(may_read(0755, 0644));
  EXPECT_FALSE(may_read(0755, 0640));
  EXPECT_FALSE(may_read(0750, 0644)) << "it may not pass the folder";
  EXPECT_FALSE(account.may(folder / "file", W_OK));
  account.groups = {facts.st_gid};
  EXPECT_TRUE(may_read(0750, 0640));
  EXPECT_FALSE(may_read(0755, 0604)) << "a group's mode counts before everybody's";
}

TEST_F(Doctor, SeesFilesThatTheServiceMayNotReadThoughWeMay) {
  write("/token", "0123456789abcdef0123456789abcdef\n");
  fs::permissions(root_ + "/token", fs::perms::owner_read);
  Config config;
  config.http.token_file = root_ + "/token";
  EXPECT_TRUE(check_files(config, kCaller).empty());
  const auto findings = check_files(config, stranger());
  ASSERT_EQ(findings.size(), 1U);
  expect(findings[0], Severity::kFault,
         "http.token_file: the service's account lcdm may not read " + root_ + "/token");
}

TEST_F(Doctor, SeesADiskAndACameraThatTheServiceMayNotUseThoughWeMay) {
  fs::permissions(root_, fs::perms::owner_all);
  expect(check_disk(root_, 0, stranger()), Severity::kWarning,
         "set record.directory to a folder that the service's account lcdm may write");
  write("/video0", "");
  V4l2Node camera = usb_camera(480, 2);
  camera.path = root_ + "/video0";
  expect(check_cameras({camera}, "auto", stranger())[0], Severity::kFault,
         "the service's account lcdm may not open it: SupplementaryGroups=video");
}

TEST_F(Doctor, AFolderThatSystemdWillMakeForTheServiceIsWritable) {
  Account account = stranger();
  account.made_at_start = root_ + "/lib/lcdm";
  EXPECT_TRUE(account.makes_at_start(root_ + "/lib/lcdm/recordings"));
  EXPECT_FALSE(account.makes_at_start(root_ + "/lib/other"));
  write("/lib/lcdm/there", "");
  EXPECT_FALSE(account.makes_at_start(root_ + "/lib/lcdm/recordings")) << "it is there";
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
  const Account caller = calling_account();
  expect(check_port("127.0.0.1", port, caller), Severity::kWarning, "is in use");
  close(fd);
  expect(check_port("127.0.0.1", port, caller), Severity::kOk, "is free");
  expect(check_port("192.0.2.1", port, caller), Severity::kWarning,
         "lacks that address now: lcdm waits");
}

// Root, who asks, might; the service may not.
TEST_F(Doctor, SeesAPortThatTheServiceMayNotHave) {
  Account service;
  service.name = "lcdm";
  service.is_caller = false;
  service.user = 999;
  expect(check_port("127.0.0.1", 80, service), Severity::kFault, "lcdm may not listen below 1024");
}

TEST_F(Doctor, SeesAClockThatNobodySets) {
  expect(check_clock(true), Severity::kOk, "synchronised");
  expect(check_clock(false), Severity::kWarning, "timedatectl");
}

TEST_F(Doctor, SeesAWatchdogThatSleeps) {
  expect(check_hardware_watchdog(root_), Severity::kWarning, "none");
  write("/sys/class/watchdog/watchdog0/identity", "i6300ESB timer\n");
  write("/sys/class/watchdog/watchdog0/state", "inactive\n");
  expect(check_hardware_watchdog(root_), Severity::kWarning, "i6300ESB timer is idle: reboot once");
  write("/sys/class/watchdog/watchdog0/state", "active\n");
  expect(check_hardware_watchdog(root_), Severity::kOk, "i6300ESB timer is active");
}

TEST_F(Doctor, SeesAServiceThatNobodyWatches) {
  const auto check = [this] { return check_service(read_service_unit(root_)); };
  expect(check(), Severity::kWarning, "not installed");
  write("/lib/systemd/system/lcdm.service", "[Service]\nType=notify\n");
  expect(check(), Severity::kWarning, "WatchdogSec= is missing");
  write("/lib/systemd/system/lcdm.service", "[Service]\nType=notify\nWatchdogSec=10\n");
  expect(check(), Severity::kOk, "WatchdogSec=10");
}

TEST_F(Doctor, SeesGpioLinesThatAreNotThere) {
  EXPECT_TRUE(check_gpio({}, root_, kCaller).empty()) << "nobody asked for one";
  Config::Gpio lines;
  lines.light = "NO.SUCH";
  lines.heartbeat = "NOR.THIS";
  const auto findings = check_gpio(lines, root_, kCaller);
  ASSERT_EQ(findings.size(), 2U);
  expect(findings[0], Severity::kWarning, "gpio.light: gpio NO.SUCH");
  expect(findings[0], Severity::kWarning, "set a name that gpioinfo lists, or none");
  expect(findings[1], Severity::kWarning, "gpio.heartbeat: gpio NOR.THIS");
}

TEST_F(Doctor, SeesAGpioChipThatTheServiceMayNotOpen) {
  write("/dev/gpiochip0", "");
  fs::permissions(root_ + "/dev/gpiochip0", fs::perms::owner_read | fs::perms::owner_write);
  Config::Gpio lines;
  lines.button = "PQ.05";
  expect(check_gpio(lines, root_, stranger())[0], Severity::kWarning,
         "/dev/gpiochip0: the service's account lcdm may not open it for gpio.button");
}

}  // namespace
}  // namespace lcdm
