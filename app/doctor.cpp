#include "app/doctor.h"

#include <iterator>
#include <sys/timex.h>
#include <utility>

#include "app/address.h"
#include "app/common_options.h"
#include "app/doctor_camera.h"
#include "app/doctor_machine.h"

namespace lcdm {
namespace {

constexpr std::uint64_t kMiB = 1U << 20;

bool clock_is_synchronised() {
  timex state{};
  return adjtimex(&state) != TIME_ERROR && (state.status & STA_UNSYNC) == 0;
}

// Who is judged; where the service is installed but its account is not, the caller.
Account account_of(const ServiceUnit& unit, std::vector<Finding>& findings) {
  if (unit.file.empty()) return calling_account();
  const Result<Account> account = service_account(unit);
  if (account) return *account;
  findings.push_back(fault("service", account.status().text()));
  return calling_account();
}

}  // namespace

std::vector<Finding> examine(const Config& configured, const std::string& root) {
  const ServiceUnit unit = read_service_unit(root);
  std::vector<Finding> findings = {check_service(unit)};
  const Account account = account_of(unit, findings);
  const Config config = as_seen_by(account, configured);
  const auto add = [&findings](std::vector<Finding> more) {
    std::move(more.begin(), more.end(), std::back_inserter(findings));
  };
  const std::vector<V4l2Node> nodes = list_v4l2_nodes();
  add(check_cameras(nodes, config.camera.source, account));
  add(check_rates(config, nodes));
  std::uint64_t engine_bytes = 0;
  findings.push_back(check_model(config, engine_bytes));
  findings.push_back(check_memory_lock(root, account, engine_bytes));
  findings.push_back(
      check_disk(config.record.directory, config.record.keep_free_megabytes, account));
  add(check_files(config, account));
  for (const std::string& address : listen_addresses(config.http.listen)) {
    findings.push_back(check_port(address, config.http.port, account));
  }
  findings.push_back(check_clock(clock_is_synchronised()));
  findings.push_back(check_hardware_watchdog(root));
  add(check_gpio(config.gpio, root, account));
  return findings;
}

Finding check_service(const ServiceUnit& unit) {
  if (unit.file.empty()) {
    return warning("service", "not installed: nothing starts lcdm at boot: install the package");
  }
  const std::string watchdog = unit.setting("WatchdogSec");
  if (watchdog.empty()) {
    return warning("service", unit.file +
                                  ": WatchdogSec= is missing: a program that hangs is "
                                  "not restarted; install the package's unit");
  }
  return well("service", unit.file + ", WatchdogSec=" + watchdog);
}

Finding check_model(const Config& config, std::uint64_t& engine_bytes) {
  const Result<ModelFile> file = load_model(config);
  if (!file) return fault("model", file.status().text());
  const CaptureRequest request = capture_request(config);
  const FrameFormat format{PixelFormat::kRgb24, request.width, request.height, request.width * 3};
  const auto engine = Engine::prepare(
      *file, engine_options(config), format,
      CameraModel::from_field_of_view(format.width, format.height, request.assumed_field_of_view));
  if (!engine) return fault("model", engine.status().text());
  const EngineStats stats = (*engine)->stats();
  engine_bytes = stats.arena_bytes + stats.weight_bytes;
  return well("model", stats.model_name + " at " + std::to_string(stats.width) + "x" +
                           std::to_string(stats.height) + ", " +
                           std::to_string(engine_bytes / kMiB) + " MiB");
}

}  // namespace lcdm
