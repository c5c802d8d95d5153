// What `auto` makes of the nodes it finds: the first that really delivers, else the rendered scene,
// and every rejected node with its reason.
#include <gtest/gtest.h>
#include <string>

#include "app/source.h"
#include "tests/support/fake_v4l2.h"

namespace lcdm {
namespace {

using test::FakeV4l2;

class AutoSourceTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!test::umockdev_active()) GTEST_SKIP() << "run under umockdev-wrapper";
  }

  std::string choose() {
    return choose_source({}, [this](const std::string& line) { said_ += line + "\n"; });
  }

  std::string said_;
};

TEST_F(AutoSourceTest, TakesANodeThatDelivers) {
  const FakeV4l2 device({});
  EXPECT_EQ(choose(), "v4l2:/dev/video0");
  EXPECT_EQ(said_, "");
}

TEST_F(AutoSourceTest, ANodeThatFailsAtFirstButDeliversInTimeIsTaken) {
  FakeV4l2::Behaviour behaviour;
  behaviour.answer = [](int n) {
    return n < 3 ? FakeV4l2::Answer::kErrorFlag : FakeV4l2::Answer::kFrame;
  };
  const FakeV4l2 device(behaviour);
  EXPECT_EQ(choose(), "v4l2:/dev/video0");
}

TEST_F(AutoSourceTest, ASilentNodeIsRejectedWithItsReason) {
  FakeV4l2::Behaviour behaviour;
  behaviour.answer = [](int) { return FakeV4l2::Answer::kNothing; };
  const FakeV4l2 device(behaviour);
  EXPECT_EQ(choose(), "scene:");
  EXPECT_NE(said_.find("no usable camera: v4l2:/dev/video0"), std::string::npos) << said_;
  EXPECT_NE(said_.find("no frame"), std::string::npos) << said_;
  EXPECT_NE(said_.find("showing the rendered scene"), std::string::npos) << said_;
}

TEST_F(AutoSourceTest, ANodeThatIsNoCameraIsRejectedWithItsReason) {
  FakeV4l2::Behaviour behaviour;
  behaviour.capabilities = V4L2_CAP_META_CAPTURE | V4L2_CAP_STREAMING;
  const FakeV4l2 device(behaviour);
  EXPECT_EQ(choose(), "scene:");
  EXPECT_NE(said_.find("/dev/video0"), std::string::npos) << said_;
}

TEST_F(AutoSourceTest, WithoutAnyNodeItSaysSo) {
  EXPECT_EQ(choose(), "scene:");
  EXPECT_EQ(said_, "no camera found (no /dev/video*); showing the rendered scene\n");
}

}  // namespace
}  // namespace lcdm
