// Training in several processes, with the real program and LibTorch's own collectives.
#include "model/processes.h"

#include <arpa/inet.h>
#include <cmath>
#include <cstdlib>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <torch/csrc/distributed/c10d/TCPStore.hpp>
#include <unistd.h>

#include "firmware/base/check.h"
#include "model/csv.h"
#include "model/safetensors.h"
#include "tests/app/program.h"
#include "tests/support/temporary_folder.h"

namespace lcdm::model {
namespace {

// One that the kernel has just found free.
int free_port() {
  const int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_ANY);  // where the first process will listen
  socklen_t length = sizeof(address);
  LCDM_CHECK(bind(fd, reinterpret_cast<const sockaddr*>(&address), length) == 0);
  LCDM_CHECK(getsockname(fd, reinterpret_cast<sockaddr*>(&address), &length) == 0);
  close(fd);
  return ntohs(address.sin_port);
}

class ProcessesTest : public testing::Test {
 protected:
  void TearDown() override { unsetenv("WORLD_SIZE"); }

  std::vector<std::string> arguments(const std::string& output, const char* workers,
                                     const char* stage,
                                     const std::vector<std::string>& more) const {
    std::vector<std::string> all = {
        "train",  "--data",      catalogue_, "--encoder", "xxs",
        "--seed", "4",           "--stage",  stage,       "--workers",
        workers,  "--head-from", "0",        "--output",  folder_.file(output)};
    all.insert(all.end(), more.begin(), more.end());
    return all;
  }
  void train_alone(const std::string& output, const std::vector<std::string>& more) const {
    test::Program program(LCDM_TRAIN_PROGRAM, arguments(output, "2", "0.25:4:1", more));
    ASSERT_EQ(program.wait(300), 0) << program.text();
  }
  void train_both(const std::string& output, const std::vector<std::string>& more) const {
    train_both_at(free_port(), "False", output, more);
  }
  static std::vector<std::string> environment(int rank, int port, const std::string& agent) {
    return {"WORLD_SIZE=2", "MASTER_ADDR=127.0.0.1", "MASTER_PORT=" + std::to_string(port),
            "TORCHELASTIC_USE_AGENT_STORE=" + agent, "RANK=" + std::to_string(rank)};
  }
  void train_both_at(int port, const std::string& agent, const std::string& output,
                     const std::vector<std::string>& more) const {
    const std::vector<std::string> each = arguments(output, "1", "0.25:2:1", more);
    test::Program first(LCDM_TRAIN_PROGRAM, each, environment(0, port, agent));
    test::Program second(LCDM_TRAIN_PROGRAM, each, environment(1, port, agent));
    ASSERT_EQ(first.wait(300), 0) << first.text();
    ASSERT_EQ(second.wait(300), 0) << second.text();
  }
  Result<TensorFile> weights_of(const std::string& output) const {
    return read_tensors(folder_.file(output + "/checkpoint.safetensors"));
  }
  // Mean distillation loss of all steps.
  double loss_of(const std::string& output) const {
    const auto curve = read_csv(folder_.file(output + "/curve.csv"));
    EXPECT_TRUE(curve) << curve.status().text();
    return curve->numbers("distillation")->back();
  }

  test::TemporaryFolder folder_;
  const std::string catalogue_ = folder_.write("scene.toml", "[scene]\nframes = 8\n");
};

// Two processes with a worker and 2 pictures each are one with two workers and 4 pictures.
TEST_F(ProcessesTest, TwoHaveTheLossesOfOneWithTheDoubledBatch) {
  train_alone("alone", {"--steps", "6"});
  train_both("both", {"--steps", "6"});
  const double expected = loss_of("alone");
  EXPECT_NEAR(loss_of("both"), expected, 1e-4 * expected);
}

// After a first step AdamW's mean is a tenth of the gradient. (The weights have all moved by the
// learning rate, however large it was.)
TEST_F(ProcessesTest, TwoHaveTheGradientOfOne) {
  const std::vector<std::string> one_step = {"--steps", "1", "--clip", "1e9"};
  train_alone("alone", one_step);
  train_both("both", one_step);
  const auto a = weights_of("alone");
  const auto b = weights_of("both");
  ASSERT_TRUE(a && b);
  double all = 0;
  double apart = 0;
  for (const auto& [name, tensor] : a->tensors) {
    if (name.rfind("adam.mean.", 0) != 0) continue;
    all += tensor.square().sum().item<double>();
    apart += (tensor - b->tensors.at(name)).square().sum().item<double>();
  }
  EXPECT_GT(all, 0);
  EXPECT_LT(std::sqrt(apart), 1e-3 * std::sqrt(all));
}

// As a machine that fails, or runs out of memory.
TEST_F(ProcessesTest, WhenOneIsKilledTheFirstSavesWhatBothTrained) {
  const int port = free_port();
  const auto each = arguments("both", "1", "0.25:2:1", {"--steps", "100000"});
  test::Program first(LCDM_TRAIN_PROGRAM, each, environment(0, port, "False"));
  test::Program second(LCDM_TRAIN_PROGRAM, each, environment(1, port, "False"));
  ASSERT_TRUE(first.wait_for("25/100000", 120)) << first.text();
  kill(second.pid(), SIGKILL);
  EXPECT_EQ(first.wait(60), 1) << first.text();
  EXPECT_NE(first.text().find("another process of this training has gone"), std::string::npos)
      << first.text();
  const auto saved = weights_of("both");
  ASSERT_TRUE(saved) << first.text();
  const auto step = saved->tensors.at("trainer.step")[0].item<std::int64_t>();
  EXPECT_GE(step, 25);
  train_both("both", {"--steps", std::to_string(step + 2), "--resume"});
}

// Each would write the other's tables.
TEST_F(ProcessesTest, TwoDoNotAblate) {
  const int port = free_port();
  const std::vector<std::string> ablate = {"ablate", "--output", folder_.file("tables")};
  test::Program first(LCDM_TRAIN_PROGRAM, ablate, environment(0, port, "False"));
  test::Program second(LCDM_TRAIN_PROGRAM, ablate, environment(1, port, "False"));
  EXPECT_EQ(first.wait(60), 2) << first.text();
  EXPECT_EQ(second.wait(60), 2) << second.text();
  EXPECT_NE(first.text().find("without torchrun"), std::string::npos) << first.text();
}

// As torchrun starts them: it listens itself, and a second server on its port would be refused.
TEST_F(ProcessesTest, TwoMeetAtTheServerOfWhoStartedThem) {
  c10d::TCPStoreOptions options;
  options.port = 0;  // any that is free
  options.isServer = true;
  options.waitWorkers = false;
  const auto server = c10::make_intrusive<c10d::TCPStore>("127.0.0.1", options);
  train_both_at(server->getPort(), "True", "both", {"--steps", "1"});
  EXPECT_TRUE(weights_of("both"));
}

TEST_F(ProcessesTest, WrongEnvironmentIsNamed) {
  setenv("WORLD_SIZE", "two", 1);
  const auto processes = Processes::join(torch::kCPU);
  ASSERT_EQ(processes.code(), StatusCode::kInvalidInput);
  EXPECT_NE(std::string(processes.status().text()).find("WORLD_SIZE is \"two\""),
            std::string::npos);
}

TEST_F(ProcessesTest, WithoutAnEnvironmentThereIsOne) {
  const auto processes = Processes::join(torch::kCPU);
  ASSERT_TRUE(processes) << processes.status().text();
  EXPECT_EQ((*processes)->size(), 1);
  EXPECT_TRUE((*processes)->any(true).value());
  EXPECT_FALSE((*processes)->any(false).value());
}

}  // namespace
}  // namespace lcdm::model
