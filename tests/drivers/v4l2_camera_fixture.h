// What the tests of `v4l2:` share: they run under umockdev-wrapper, with a scripted kernel.
#pragma once

#include <chrono>
#include <functional>
#include <gtest/gtest.h>
#include <utility>

#include "drivers/v4l2/camera.h"
#include "tests/support/fake_v4l2.h"

namespace lcdm {

using test::FakeV4l2;
using Answer = FakeV4l2::Answer;
using std::chrono::milliseconds;

class V4l2CameraTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!test::umockdev_active()) GTEST_SKIP() << "run under umockdev-wrapper";
  }
};

inline FakeV4l2::Behaviour answering(std::function<Answer(int)> answer) {
  FakeV4l2::Behaviour behaviour;
  behaviour.answer = std::move(answer);
  return behaviour;
}

// Configures and starts; the test fails with the driver's own words if that does not work.
inline void open_camera(V4l2Camera& camera) {
  const Status configured = camera.configure({});
  ASSERT_TRUE(configured) << configured.text();
  const Status started = camera.start();
  ASSERT_TRUE(started) << started.text();
}

}  // namespace lcdm
