// The soak: `lcdm run` as it is shipped, at its real speed, on a scripted camera, under random
// faults of camera, disk and clients. Depth must flow within 2 s after each is over, nothing may
// grow, every kind must have been felt, and every frame must turn up in a count.
//
//   LCDM_SOAK_SEED=N       the same faults in the same order and of the same lengths
//   LCDM_SOAK_SECONDS=N    so long beyond one fault of every kind, in place of 4
#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <gtest/gtest.h>
#include <map>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "firmware/base/os.h"
#include "firmware/pipeline/recovery_ladder.h"
#include "tests/app/depth_watcher.h"
#include "tests/app/soak_camera.h"
#include "tests/app/soak_service.h"

namespace lcdm {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using Mood = test::SoakCamera::Mood;

// The product's promise, from the end of a fault to the second depth.
constexpr std::int64_t kLimitNs = 2'000'000'000;
constexpr milliseconds kLongestBackOff = RecoveryOptions().last_backoff;
// What the allocator, and stacks that are used more deeply than before, may add.
constexpr double kMemoryMargin = 1.03;

int from_environment(const char* name, int otherwise) {
  const char* text = std::getenv(name);  // NOLINT(concurrency-mt-unsafe): one thread yet
  return text == nullptr ? otherwise : std::atoi(text);
}

double seconds_of(std::int64_t ns) { return static_cast<double>(ns) * 1e-9; }

struct Fault {
  std::string name;
  milliseconds least;  // it lasts
  milliseconds most;
  std::function<void()> begins;
  // Empty: it is over as soon as the product does something about it, and time counts from its
  // beginning.
  std::function<void()> ends;
  // What rises when it is felt.
  std::function<std::int64_t()> felt;
  // False: depth flows all the while.
  bool stops_depth = true;
};

class Soak {
 public:
  void run();

 private:
  // What became of one kind of fault.
  struct Record {
    int count = 0;
    std::int64_t felt = 0;
    std::int64_t longest_ns = 0;  // until depth flowed
  };

  void start() {
    std::printf("seed %u, %d s\n", seed_, seconds_);
    std::fflush(stdout);  // known also of a run that is killed
    ASSERT_TRUE(service_.streams()) << service_.text();
    watcher_ = std::make_unique<test::DepthWatcher>(service_.port());
    add_faults_of_the_stream();
    add_faults_of_the_device();
    add_faults_of_the_outputs();
  }

  milliseconds between(milliseconds least, milliseconds most) {
    return milliseconds(std::uniform_int_distribution<int>(
        static_cast<int>(least.count()), static_cast<int>(most.count()))(random_));
  }

  // A camera in this mood, as long as the fault lasts.
  void add(const char* name, Mood mood, milliseconds most, std::function<std::int64_t()> felt,
           bool stops_depth = true) {
    faults_.push_back({name, milliseconds(500), most, [this, mood] { camera_.set_mood(mood); },
                       [this] { camera_.set_mood(Mood::kWell); }, std::move(felt), stops_depth});
  }
  std::function<std::int64_t()> figure(const char* pointer) {
    return [this, pointer] { return service_.figure(pointer); };
  }
  // Rungs of the ladder that were stepped on: which depends on what went before.
  std::int64_t steps() {
    return service_.figure("/recovery/stream_restarts") + service_.figure("/recovery/reopenings") +
           service_.figure("/recovery/port_resets");
  }

  void add_faults_of_the_stream() {
    add("frames lost", Mood::kLosesFrames, milliseconds(800), figure("/frames/sequence_gaps"),
        false);
    add("frames marked damaged", Mood::kMarksFrames, milliseconds(800), figure("/frames/corrupt"),
        false);
    add("JPEGs cut", Mood::kCutsFrames, milliseconds(2500), figure("/frames/corrupt"));
    add("JPEGs with wrong bits", Mood::kFlipsBits, milliseconds(1500), figure("/frames/corrupt"));
    add("stream silent", Mood::kSilent, milliseconds(2500), figure("/frames/timeouts"));
    add("stream fails", Mood::kFailsStreams, milliseconds(2000), [this] { return steps(); });
    faults_.push_back({"stream hangs until restarted", milliseconds(0), milliseconds(0),
                       [this] { camera_.set_mood(Mood::kHangs); }, nullptr,
                       [this] { return steps(); }});
  }

  void add_faults_of_the_device() {
    add("camera gone, untold", Mood::kVanished, milliseconds(2000),
        figure("/recovery/device_waits"));
    faults_.push_back({"camera unplugged", milliseconds(300), milliseconds(2000),
                       [this] { camera_.unplug(); }, [this] { camera_.plug_in(); },
                       figure("/recovery/device_waits")});
  }

  void add_faults_of_the_outputs() {
    // Long enough for every slot of the recorder to wait.
    faults_.push_back({"disk hangs", milliseconds(600), milliseconds(1500),
                       [this] {
                         service_.start_recording();
                         may_trace_ = service_.halt_disk();
                       },
                       [this] {
                         if (may_trace_) service_.release_disk();
                         service_.stop_recording();
                         frames_without_slot_ += figure("/recording/dropped")();
                       },
                       [this] { return frames_without_slot_; }, false});
    // Long enough for a chunk to be written, which is a second of frames.
    faults_.push_back({"disk full", milliseconds(1300), milliseconds(1800),
                       [this] {
                         service_.start_recording();
                         service_.fill_disk(true);
                       },
                       [this] {
                         const auto now =
                             service_.status().value("recording", nlohmann::json::object());
                         ended_recordings_ += now.value("fault", "").empty() ? 0 : 1;
                         service_.fill_disk(false);
                       },
                       [this] { return ended_recordings_; }, false});
    // They stay attached until the next of this kind.
    faults_.push_back({"clients do not read", milliseconds(300), milliseconds(600),
                       [this] {
                         service_.detach_clients();
                         service_.attach_stalled_clients();
                       },
                       [this] { crowds_ += service_.figure("/viewers") > 1 ? 1 : 0; },
                       [this] { return crowds_; }, false});
  }

  // Brings it about and waits until depth flows again. False: it does not.
  bool suffer(const Fault& fault) {
    // What the product must notice by itself has its back-off in the bill: it begins after depth
    // for as long as makes that short again.
    if (!fault.ends) std::this_thread::sleep_for(kLongestBackOff);
    Record& record = records_[fault.name];
    const std::int64_t felt_before = fault.felt();
    const std::int64_t begin_ns = os::monotonic_ns();
    fault.begins();
    std::this_thread::sleep_for(between(fault.least, fault.most));
    const std::int64_t over_ns = fault.ends ? os::monotonic_ns() : begin_ns;
    if (fault.ends) fault.ends();
    const auto flows_ns = watcher_->flows_after(over_ns, seconds(60));
    if (!flows_ns) return false;
    const std::int64_t away_ns =
        fault.stops_depth ? *flows_ns - over_ns : watcher_->longest_gap_ns(begin_ns, *flows_ns);
    record.longest_ns = std::max(record.longest_ns, away_ns);
    record.felt += fault.felt() - felt_before;
    ++record.count;
    std::printf("  %-30s %.2f s\n", fault.name.c_str(), seconds_of(away_ns));
    be_calm();
    return true;
  }

  // A while without a fault: what depth is away in it is this machine's doing. Too short for the
  // ladder to begin at its bottom again, so it is judged by its longest back-off.
  void be_calm() {
    const std::int64_t begin_ns = os::monotonic_ns();
    std::this_thread::sleep_for(between(milliseconds(300), milliseconds(700)));
    calm_gap_ns_ = std::max(calm_gap_ns_, watcher_->longest_gap_ns(begin_ns, os::monotonic_ns()));
  }

  // Every kind once, in random order.
  void suffer_each() {
    std::shuffle(faults_.begin(), faults_.end(), random_);
    for (const Fault& fault : faults_) {
      ASSERT_TRUE(suffer(fault)) << fault.name << ": depth never came back\n" << service_.text();
    }
  }

  // Nothing is attached or recorded: what is held then is held for ever. The least of some looks,
  // for our own questions are connections, too.
  int settled_descriptors() {
    service_.detach_clients();
    int least = service_.descriptors();
    for (int i = 0; i < 50; ++i) {
      std::this_thread::sleep_for(milliseconds(20));
      least = std::min(least, service_.descriptors());
    }
    return least;
  }

  void expect_every_frame_counted();
  void expect_limits_kept() const;

  const std::uint32_t seed_ = static_cast<std::uint32_t>(
      from_environment("LCDM_SOAK_SEED", static_cast<int>(std::random_device()() >> 1)));
  const int seconds_ = from_environment("LCDM_SOAK_SECONDS", 4);
  std::mt19937 random_{seed_};
  test::SoakCamera camera_{seed_};
  test::SoakService service_;
  std::unique_ptr<test::DepthWatcher> watcher_;
  std::vector<Fault> faults_;
  std::map<std::string, Record> records_;
  std::int64_t calm_gap_ns_ = 0;
  std::int64_t ended_recordings_ = 0;
  std::int64_t frames_without_slot_ = 0;
  std::int64_t crowds_ = 0;
  bool may_trace_ = true;
};

// What the kernel's side gave is what the product's figures add up to.
void Soak::expect_every_frame_counted() {
  camera_.set_mood(Mood::kSilent);
  std::this_thread::sleep_for(seconds(1));  // nothing is on its way any more
  const auto frames = service_.status().value("frames", nlohmann::json::object());
  std::uint64_t counted = 0;
  for (const char* fate : {"inferred", "dropped", "skipped", "corrupt", "failed"}) {
    counted += frames.value(fate, std::uint64_t{0});
  }
  EXPECT_EQ(counted, camera_.account().delivered) << frames;
  EXPECT_EQ(frames.value("sequence_gaps", std::uint64_t{0}), camera_.account().lost) << frames;
}

void Soak::expect_limits_kept() const {
  std::printf("longest without depth when there was no fault: %.2f s\n", seconds_of(calm_gap_ns_));
  for (const auto& [name, record] : records_) {
    std::printf("  %-30s %3d times, felt %4lld, depth at last after %.2f s\n", name.c_str(),
                record.count, static_cast<long long>(record.felt), seconds_of(record.longest_ns));
    EXPECT_LE(record.longest_ns, kLimitNs + calm_gap_ns_) << name;
    const bool halted = name != "disk hangs" || may_trace_;
    if (!halted) std::puts("  (ptrace is not allowed here: the disk never hung)");
    EXPECT_TRUE(record.felt > 0 || !halted) << name << ": it was not felt";
  }
}

void Soak::run() {
  start();
  if (testing::Test::HasFatalFailure()) return;
  be_calm();
  suffer_each();  // what is made at first use is no leak
  if (testing::Test::HasFatalFailure()) return;
  const int descriptors = settled_descriptors();
  const std::int64_t resident = service_.resident_kilobytes();
  const std::int64_t end_ns = os::monotonic_ns() + seconds_ * 1'000'000'000LL;
  std::uniform_int_distribution<std::size_t> any(0, faults_.size() - 1);
  while (os::monotonic_ns() < end_ns) ASSERT_TRUE(suffer(faults_[any(random_)])) << service_.text();

  const int descriptors_after = settled_descriptors();
  const std::int64_t resident_after = service_.resident_kilobytes();
  std::printf("resident %lld kB, then %lld kB; open files %d, then %d\n",
              static_cast<long long>(resident), static_cast<long long>(resident_after), descriptors,
              descriptors_after);
  EXPECT_EQ(descriptors_after, descriptors);
  EXPECT_LE(static_cast<double>(resident_after), kMemoryMargin * static_cast<double>(resident));
  expect_limits_kept();
  expect_every_frame_counted();
  EXPECT_EQ(service_.stop(), 0) << service_.text();
}

TEST(Soak, DepthComesBackAndNothingGrowsOrGoesMissing) {
  if (!test::umockdev_active()) GTEST_SKIP() << "run under umockdev-wrapper";
  Soak().run();
}

}  // namespace
}  // namespace lcdm
