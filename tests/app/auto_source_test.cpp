// What `auto` makes of the nodes it finds: the first that really delivers, else every rejected node
// with its reason. And what commands say to people who have such a node.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <string>

#include "app/source.h"
#include "tests/app/program.h"
#include "tests/support/fake_v4l2.h"

namespace lcdm {
namespace {

using test::FakeV4l2;
using testing::AllOf;
using testing::HasSubstr;

class AutoSourceTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!test::umockdev_active()) GTEST_SKIP() << "run under umockdev-wrapper";
  }

  std::string found() {
    const Result<std::string> source = find_camera({}, rejected_);
    return source ? *source : source.status().text();
  }

  std::string rejected_;
};

TEST_F(AutoSourceTest, TakesANodeThatDelivers) {
  const FakeV4l2 device({});
  EXPECT_EQ(found(), "v4l2:/dev/video0");
  EXPECT_EQ(rejected_, "");
}

TEST_F(AutoSourceTest, ANodeThatFailsAtFirstButDeliversInTimeIsTaken) {
  FakeV4l2::Behaviour behaviour;
  behaviour.answer = [](int n) {
    return n < 3 ? FakeV4l2::Answer::kErrorFlag : FakeV4l2::Answer::kFrame;
  };
  const FakeV4l2 device(behaviour);
  EXPECT_EQ(found(), "v4l2:/dev/video0");
}

TEST_F(AutoSourceTest, ASilentNodeIsRejectedWithItsReason) {
  FakeV4l2::Behaviour behaviour;
  behaviour.answer = [](int) { return FakeV4l2::Answer::kNothing; };
  const FakeV4l2 device(behaviour);
  EXPECT_THAT(found(),
              AllOf(HasSubstr("no usable camera: v4l2:/dev/video0"), HasSubstr("no frame")));
}

TEST_F(AutoSourceTest, ANodeThatIsNoCameraIsRejectedWithItsReason) {
  FakeV4l2::Behaviour behaviour;
  behaviour.capabilities = V4L2_CAP_META_CAPTURE | V4L2_CAP_STREAMING;
  const FakeV4l2 device(behaviour);
  EXPECT_THAT(found(), AllOf(HasSubstr("no usable camera"), HasSubstr("/dev/video0")));
}

TEST_F(AutoSourceTest, CalibratingWithASilentCameraSaysThatNothingComes) {
  FakeV4l2::Behaviour behaviour;
  behaviour.answer = [](int) { return FakeV4l2::Answer::kNothing; };
  const FakeV4l2 device(behaviour);
  test::Program program(LCDM_PROGRAM, {"calibrate", "--source", "v4l2:/dev/video0"});
  EXPECT_TRUE(program.wait_for("no frame in time: nothing for 3 s")) << program.text();
  kill(program.pid(), SIGINT);
  EXPECT_NE(program.wait(), -1) << "it ends: " << program.text();
}

TEST_F(AutoSourceTest, WithoutAnyNodeItSaysSo) {
  EXPECT_EQ(found(), "no camera found (no /dev/video*)");
}

}  // namespace
}  // namespace lcdm
