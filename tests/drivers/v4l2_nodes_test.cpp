// Which nodes there are and which of them a text means, in a system that does not exist.
#include <cerrno>
#include <filesystem>
#include <gtest/gtest.h>
#include <string>
#include <sys/fsuid.h>
#include <system_error>

#include "drivers/v4l2/camera.h"
#include "drivers/v4l2/nodes.h"
#include "firmware/base/printable.h"
#include "tests/support/fake_v4l2.h"

namespace lcdm {
namespace {

using test::FakeV4l2;

// While it lives, files are opened as by anybody, also where the tests run as root.
class NoSuperuser {
 public:
  NoSuperuser() : before_(setfsuid(65'534)) {}
  ~NoSuperuser() { setfsuid(static_cast<uid_t>(before_)); }
  NoSuperuser(const NoSuperuser&) = delete;
  NoSuperuser& operator=(const NoSuperuser&) = delete;

 private:
  const int before_;
};

class V4l2NodesTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!test::umockdev_active()) GTEST_SKIP() << "run under umockdev-wrapper";
    on_usb_.on_usb = true;
  }

  FakeV4l2::Behaviour on_usb_;
};

TEST_F(V4l2NodesTest, SkipsNodesThatCaptureNothingAndSaysWhy) {
  FakeV4l2::Behaviour behaviour;
  behaviour.capabilities = V4L2_CAP_META_CAPTURE | V4L2_CAP_STREAMING;
  const FakeV4l2 device(behaviour);
  const auto nodes = list_v4l2_nodes();
  ASSERT_EQ(nodes.size(), 1U);
  EXPECT_EQ(nodes[0].path, FakeV4l2::kPath);
  EXPECT_FALSE(nodes[0].usable);
  EXPECT_NE(nodes[0].reason.find("captures no"), std::string::npos) << nodes[0].reason;
}

TEST_F(V4l2NodesTest, NamesTheFormatsOfANodeThatHasNoneForUs) {
  FakeV4l2::Behaviour behaviour;
  behaviour.fourcc = V4L2_PIX_FMT_SRGGB10;
  const FakeV4l2 device(behaviour);
  const auto nodes = list_v4l2_nodes();
  ASSERT_EQ(nodes.size(), 1U);
  EXPECT_FALSE(nodes[0].usable);
  EXPECT_NE(nodes[0].reason.find("offers RG10"), std::string::npos) << nodes[0].reason;
}

TEST_F(V4l2NodesTest, ListsAUsableNodeWithItsName) {
  const FakeV4l2 device({});
  const auto nodes = list_v4l2_nodes();
  ASSERT_EQ(nodes.size(), 1U);
  EXPECT_TRUE(nodes[0].usable) << nodes[0].reason;
  EXPECT_EQ(nodes[0].card, "fake camera");
  EXPECT_EQ(nodes[0].driver, "fake");
  EXPECT_EQ(nodes[0].usb, "") << "it is not on USB";
}

// Its maker, or whoever made it look so, decides what is in a device's name.
TEST(DevicesOwnWords, SteerNoTerminal) {
  EXPECT_EQ(printable("Cam\x1b]0;x\x07\n\x7f"), "Cam?]0;x???");
  EXPECT_EQ(printable("Cam\xC2\x9B 2"), "Cam\xC2? 2") << "a control character of two bytes";
  EXPECT_EQ(printable("Cam\xC3\xA9ra"), "Cam\xC3\xA9ra");
}

TEST_F(V4l2NodesTest, KnowsTheUsbDeviceBehindANode) {
  const FakeV4l2 device(on_usb_);
  const auto nodes = list_v4l2_nodes();
  ASSERT_EQ(nodes.size(), 1U);
  EXPECT_EQ(nodes[0].serial, "F00D");
  EXPECT_EQ(nodes[0].usb, FakeV4l2::kUsbPath);
  EXPECT_FLOAT_EQ(nodes[0].usb_mbps, 480);
  EXPECT_FLOAT_EQ(nodes[0].usb_version, 3.2F);
}

TEST_F(V4l2NodesTest, ACameraIsFoundByItsSerialOrItsName) {
  const FakeV4l2 device(on_usb_);
  for (const char* selector : {"any", "serial=F00D", "name=fake camera", "/dev/video0"}) {
    const auto node = find_v4l2_node(selector);
    ASSERT_TRUE(node) << node.status().text();
    EXPECT_EQ(*node, "/dev/video0");
    V4l2Camera camera(selector);
    ASSERT_TRUE(camera.configure({})) << selector;
    EXPECT_EQ(camera.info().uri, std::string("v4l2:") + selector) << "it stays what it was";
    EXPECT_EQ(camera.info().usb, FakeV4l2::kUsbPath);
  }
}

TEST_F(V4l2NodesTest, ALinkThatSurvivesReplugsOpensItsCamera) {
  const FakeV4l2 device(on_usb_);
  V4l2Camera camera(FakeV4l2::kLink);
  const Status status = camera.configure({});
  ASSERT_TRUE(status) << status.text();
  EXPECT_EQ(camera.info().uri, std::string("v4l2:") + FakeV4l2::kLink) << "it stays what it was";
  EXPECT_EQ(camera.info().usb, FakeV4l2::kUsbPath) << "the port behind the link is known";
}

TEST_F(V4l2NodesTest, AClosedCameraHoldsItsNodeNoMore) {
  const FakeV4l2 device(on_usb_);
  const auto held = [] {  // the simulated node lies in a folder of its own
    int nodes = 0;
    for (const auto& descriptor : std::filesystem::directory_iterator("/proc/self/fd")) {
      std::error_code gone;
      nodes += std::filesystem::read_symlink(descriptor, gone).filename() == "video0" ? 1 : 0;
    }
    return nodes;
  };
  const int by_the_fake = held();
  V4l2Camera camera("any");
  ASSERT_TRUE(camera.configure({}));
  ASSERT_TRUE(camera.start());
  EXPECT_EQ(held(), by_the_fake + 1);
  camera.close();
  EXPECT_EQ(held(), by_the_fake);
  EXPECT_EQ(camera.info().usb, FakeV4l2::kUsbPath) << "for the reset of its port";
}

TEST_F(V4l2NodesTest, WhatLastsIsWhatNoOtherCameraHas) {
  const FakeV4l2 device(on_usb_);
  const V4l2Node ours = list_v4l2_nodes().at(0);
  EXPECT_EQ(lasting_selector(ours, {ours}), "serial=F00D");

  V4l2Node other = ours;
  other.path = "/dev/video2";
  other.card = "another camera";
  EXPECT_EQ(lasting_selector(ours, {ours, other}), "name=fake camera") << "serials that are shared";
  other.card = ours.card;
  EXPECT_EQ(lasting_selector(ours, {ours, other}), FakeV4l2::kLink);
  EXPECT_EQ(lasting_selector(other, {ours, other}), "/dev/video2") << "udev made no link to it";

  V4l2Node metadata = other;
  metadata.usable = false;
  EXPECT_EQ(lasting_selector(ours, {ours, metadata}), "serial=F00D") << "its own second node";
}

TEST_F(V4l2NodesTest, ACameraThatIsNotThereIsNotFound) {
  const FakeV4l2 device(on_usb_);
  for (const char* selector : {"serial=BEEF", "name=fake", "serial="}) {
    const auto node = find_v4l2_node(selector);
    EXPECT_EQ(node.code(), StatusCode::kNotFound) << selector;
    EXPECT_EQ(V4l2Camera(selector).configure({}).code(), StatusCode::kNotFound) << selector;
  }
}

TEST_F(V4l2NodesTest, ACameraThatMayNotBeOpenedIsNotAbsent) {
  FakeV4l2 device(on_usb_);
  device.close_to_everybody();
  const NoSuperuser here;
  for (const char* selector : {"any", "serial=F00D", "name=fake"}) {
    V4l2Camera camera(selector);
    const Status status = camera.configure({});
    EXPECT_EQ(camera.info().usb, FakeV4l2::kUsbPath) << "whose port is known";
    EXPECT_EQ(status.sys_errno(), EACCES) << selector << ": " << status.text();
    EXPECT_NE(std::string(status.text()).find("group video"), std::string::npos) << status.text();
  }
  EXPECT_EQ(find_v4l2_node("serial=BEEF").code(), StatusCode::kNotFound) << "another camera";
}

// Waiting for it would be for ever, and a reset of its port may cure it.
TEST_F(V4l2NodesTest, ACameraThatFailsIsNotAbsent) {
  on_usb_.refuse = [](unsigned request) { return request == VIDIOC_QUERYCAP ? EIO : 0; };
  const FakeV4l2 device(on_usb_);
  for (const char* selector : {"any", "serial=F00D", "name=fake", "/dev/video0"}) {
    V4l2Camera camera(selector);
    const Status status = camera.configure({});
    EXPECT_EQ(status.sys_errno(), EIO) << selector << ": " << status.text();
    EXPECT_EQ(camera.info().usb, FakeV4l2::kUsbPath);
  }
}

TEST_F(V4l2NodesTest, WithoutAnyUsableNodeThereIsNothingToTake) {
  EXPECT_EQ(find_v4l2_node("any").code(), StatusCode::kNotFound) << "no node at all";
  FakeV4l2::Behaviour behaviour;
  behaviour.capabilities = V4L2_CAP_META_CAPTURE | V4L2_CAP_STREAMING;
  FakeV4l2 device(behaviour);
  V4l2Camera camera("any");
  const Status none = camera.configure({});
  EXPECT_EQ(none.code(), StatusCode::kNotFound) << "one that captures nothing";
  EXPECT_NE(std::string(none.text()).find("captures no video"), std::string::npos) << none.text();
  device.set_behaviour({});
  const Status status = camera.configure({});
  EXPECT_TRUE(status) << "looked for again: " << status.text();
}

}  // namespace
}  // namespace lcdm
