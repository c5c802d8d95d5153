// News of devices and port resets, in a system that does not exist.
#include "drivers/usb_port.h"

#include <cerrno>
#include <gtest/gtest.h>

#include "drivers/v4l2/camera.h"
#include "tests/support/fake_v4l2.h"

namespace lcdm {
namespace {

using std::chrono::milliseconds;
using test::FakeV4l2;

class UsbPortTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!test::umockdev_active()) GTEST_SKIP() << "run under umockdev-wrapper";
    behaviour_.on_usb = true;
  }

  FakeV4l2::Behaviour behaviour_;
};

TEST_F(UsbPortTest, AnArrivalIsHeardOnce) {
  FakeV4l2 device(behaviour_);
  UsbPort port;
  EXPECT_FALSE(port.wait_for_arrival(milliseconds(1)));
  device.announce("add");
  EXPECT_TRUE(port.wait_for_arrival(milliseconds(5000)));
  EXPECT_FALSE(port.wait_for_arrival(milliseconds(1)));
}

TEST_F(UsbPortTest, ADepartureIsNoArrival) {
  FakeV4l2 device(behaviour_);
  UsbPort port;
  device.announce("remove");
  EXPECT_FALSE(port.wait_for_arrival(milliseconds(100)));
}

TEST_F(UsbPortTest, ResetsTheUsbDevice) {
  const FakeV4l2 device(behaviour_);
  UsbPort port;
  const Status status = port.reset(FakeV4l2::kUsbPath);
  EXPECT_TRUE(status) << status.text();
  EXPECT_EQ(device.usb_resets(), 1);
}

TEST_F(UsbPortTest, ACameraThatCouldNotBeOpenedSaysWhichDeviceToReset) {
  behaviour_.refuse = [](unsigned request) {
    return request == static_cast<unsigned>(VIDIOC_S_FMT) ? EIO : 0;
  };
  const FakeV4l2 device(behaviour_);
  V4l2Camera camera(FakeV4l2::kPath);
  EXPECT_EQ(camera.configure({}).code(), StatusCode::kIoError);
  EXPECT_EQ(camera.info().usb, FakeV4l2::kUsbPath);
}

TEST_F(UsbPortTest, WhatCannotBeResetSaysWhy) {
  const FakeV4l2 device(behaviour_);
  UsbPort port;
  EXPECT_EQ(port.reset("").code(), StatusCode::kUnsupported) << "a camera that is not on USB";
  EXPECT_EQ(port.reset("/dev/bus/usb/001/009").code(), StatusCode::kIoError);
  EXPECT_EQ(device.usb_resets(), 0);
}

}  // namespace
}  // namespace lcdm
