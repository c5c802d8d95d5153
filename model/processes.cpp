#include "model/processes.h"

#include <charconv>
#include <cstdlib>
#include <cstring>

// LibTorch says which backends it has; their headers need those of the libraries beneath.
#if defined(USE_C10D_GLOO) && __has_include(<gloo/algorithm.h>)
#define LCDM_GLOO
#include <torch/csrc/distributed/c10d/ProcessGroupGloo.hpp>
#endif
#if defined(USE_C10D_NCCL) && __has_include(<nccl.h>)
#define LCDM_NCCL
#include <torch/csrc/distributed/c10d/ProcessGroupNCCL.hpp>
#endif
#if defined(LCDM_GLOO) || defined(LCDM_NCCL)
#define LCDM_C10D
#include <torch/csrc/distributed/c10d/PrefixStore.hpp>
#include <torch/csrc/distributed/c10d/TCPStore.hpp>
#endif

namespace lcdm::model {
namespace {

class Alone final : public Processes {
 public:
  int rank() const override { return 0; }
  int size() const override { return 1; }
  Status sum(torch::Tensor& /*values*/) override { return Status::ok(); }
};

// A whole number of the environment.
Result<int> number_of(const char* name) {
  const char* text = std::getenv(name);
  int value = 0;
  const char* end = text == nullptr ? nullptr : text + std::strlen(text);
  if (text == nullptr || std::from_chars(text, end, value).ptr != end || value < 0) {
    return Status::error(StatusCode::kInvalidInput,
                         "environment variable %s is \"%s\", not a number from 0: start the "
                         "processes with torchrun, or set RANK, WORLD_SIZE, MASTER_ADDR and "
                         "MASTER_PORT",
                         name, text == nullptr ? "" : text);
  }
  return value;
}

#ifdef LCDM_C10D
std::string first_line(const std::exception& error) {
  const std::string what = error.what();
  return what.substr(0, what.find('\n'));
}

template <typename Backend>
class Group final : public Processes {
 public:
  Group(c10::intrusive_ptr<Backend> backend, const torch::Device& device, int rank, int size)
      : backend_(std::move(backend)), device_(device), rank_(rank), size_(size) {}

  int rank() const override { return rank_; }
  int size() const override { return size_; }
  Status sum(torch::Tensor& values) override {
    std::vector<torch::Tensor> tensors = {values.to(device_)};
    try {
      backend_->allreduce(tensors)->wait();
    } catch (const std::exception& error) {
      return Status::error(StatusCode::kUnavailable,
                           "another process of this training has gone (%s): look at what it said, "
                           "and start all of them again",
                           first_line(error).c_str());
    }
    values.copy_(tensors[0]);
    return Status::ok();
  }

 private:
  c10::intrusive_ptr<Backend> backend_;
  torch::Device device_;
  int rank_;
  int size_;
};

#ifdef LCDM_GLOO
// Over the network interface that GLOO_SOCKET_IFNAME names, or that of this machine's host name.
c10::intrusive_ptr<c10d::ProcessGroupGloo> make_gloo(const c10::intrusive_ptr<c10d::Store>& store,
                                                     int rank, int size) {
  const char* interface = std::getenv("GLOO_SOCKET_IFNAME");
  auto options = c10d::ProcessGroupGloo::Options::create();
  options->devices.push_back(interface != nullptr
                                 ? c10d::ProcessGroupGloo::createDeviceForInterface(interface)
                                 : c10d::ProcessGroupGloo::createDefaultDevice());
  return c10::make_intrusive<c10d::ProcessGroupGloo>(store, rank, size, options);
}
#endif

// Where the processes find each other: a server that the first of them opens, or torchrun's own,
// which outlives them: each attempt to start them then has names of its own there.
c10::intrusive_ptr<c10d::Store> open_store(const char* host, int port, int rank, int size) {
  const char* agent = std::getenv("TORCHELASTIC_USE_AGENT_STORE");
  const bool has_server = agent != nullptr && std::strcmp(agent, "True") == 0;
  c10d::TCPStoreOptions options;
  options.port = static_cast<std::uint16_t>(port);
  options.isServer = rank == 0 && !has_server;
  options.numWorkers = static_cast<std::size_t>(size);
  auto store = c10::make_intrusive<c10d::TCPStore>(host, options);
  if (!has_server) return store;
  const char* attempt = std::getenv("TORCHELASTIC_RESTART_COUNT");
  return c10::make_intrusive<c10d::PrefixStore>(
      std::string("/worker/attempt_") + (attempt != nullptr ? attempt : "0"), store);
}

std::shared_ptr<Processes> make_group(const torch::Device& device,
                                      const c10::intrusive_ptr<c10d::Store>& store, int rank,
                                      int size) {
#ifdef LCDM_NCCL
  if (device.is_cuda()) {
    return std::make_shared<Group<c10d::ProcessGroupNCCL>>(
        c10::make_intrusive<c10d::ProcessGroupNCCL>(store, rank, size), device, rank, size);
  }
#endif
#ifdef LCDM_GLOO
  if (device.is_cpu()) {
    return std::make_shared<Group<c10d::ProcessGroupGloo>>(make_gloo(store, rank, size), device,
                                                           rank, size);
  }
#endif
  return nullptr;
}
#endif

Status no_backend(const torch::Device& device) {
  return Status::error(StatusCode::kUnavailable,
                       "this program was built without %s: one process only (install %s and build "
                       "again)",
                       device.is_cuda() ? "NCCL" : "Gloo",
                       device.is_cuda() ? "NCCL's headers" : "libgloo-dev");
}

}  // namespace

std::shared_ptr<Processes> alone() { return std::make_shared<Alone>(); }

Result<bool> Processes::any(bool mine) {
  torch::Tensor value = torch::full({1}, mine ? 1.0 : 0.0, torch::kFloat32);
  LCDM_RETURN_IF_ERROR(sum(value));
  return value.item<float>() > 0;
}

Result<int> local_rank() {
  if (std::getenv("LOCAL_RANK") == nullptr) return 0;
  return number_of("LOCAL_RANK");
}

Result<std::shared_ptr<Processes>> Processes::join(const torch::Device& device) {
  if (std::getenv("WORLD_SIZE") == nullptr) return alone();
  const Result<int> size = number_of("WORLD_SIZE");
  if (!size) return size.status();
  const Result<int> rank = number_of("RANK");
  if (!rank) return rank.status();
  const Result<int> port = number_of("MASTER_PORT");
  if (!port) return port.status();
  const char* host = std::getenv("MASTER_ADDR");
  if (host == nullptr || *rank >= *size || *port > 65535) {
    return Status::error(StatusCode::kInvalidInput,
                         "MASTER_ADDR is missing, RANK is not below WORLD_SIZE, or MASTER_PORT is "
                         "no port: start the processes with torchrun");
  }
#ifdef LCDM_C10D
  try {
    const auto store = open_store(host, *port, *rank, *size);
    std::shared_ptr<Processes> group = make_group(device, store, *rank, *size);
    if (group != nullptr) return group;
  } catch (const std::exception& error) {
    return Status::error(StatusCode::kUnavailable, "process %d of %d cannot join %s:%d: %s", *rank,
                         *size, host, *port, first_line(error).c_str());
  }
#endif
  return no_backend(device);
}

}  // namespace lcdm::model
