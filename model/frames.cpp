#include "model/frames.h"

#include <algorithm>
#include <cstdlib>
#include <optional>

namespace lcdm::model {

namespace {

constexpr double kMostUneven = 3;  // one frame left out, or two, does not part its neighbours

// The number, or the seconds, that a name ends with.
std::optional<double> number_of(const std::string& name) {
  const std::size_t before = name.find_last_not_of("0123456789.");
  const std::string digits = name.substr(before == std::string::npos ? 0 : before + 1);
  char* end = nullptr;
  const double number = std::strtod(digits.c_str(), &end);
  if (digits.empty() || end != digits.c_str() + digits.size()) return std::nullopt;
  return number;
}

// Whether no frames are missing on one side of the middle one: the other is not much nearer. Names
// without numbers do not tell.
bool evenly_spaced(const std::string& before, const std::string& middle, const std::string& after) {
  const std::optional<double> first = number_of(before);
  const std::optional<double> second = number_of(middle);
  const std::optional<double> third = number_of(after);
  if (!first || !second || !third) return true;
  const auto [least, most] = std::minmax({*second - *first, *third - *second});
  return most <= kMostUneven * least;
}

}  // namespace

bool amid_a_sequence(const Frames& frames, std::size_t index) {
  if (index == 0 || index + 1 >= frames.size()) return false;
  const std::string before = frames.name(index - 1);
  const std::string middle = frames.name(index);
  const std::string after = frames.name(index + 1);
  const std::string sequence = sequence_of(middle);
  return sequence_of(before) == sequence && sequence_of(after) == sequence &&
         evenly_spaced(before, middle, after);
}

bool Frames::has_neighbours(std::size_t /*index*/) const { return false; }

Result<cv::Mat> Frames::neighbour(std::size_t index, int /*offset*/) const {
  return Status::error(StatusCode::kNotFound, "%s has no neighbours in time", name(index).c_str());
}

bool MemoryFrames::has_neighbours(std::size_t index) const {
  return video_ && amid_a_sequence(*this, index);
}

Result<PackFrame> MemoryFrames::read(std::size_t index) const {
  const auto why = unreadable_.find(index);
  if (why != unreadable_.end()) return why->second;
  return frames_[index];
}

Result<cv::Mat> MemoryFrames::neighbour(std::size_t index, int offset) const {
  const Result<PackFrame> frame = read(index + static_cast<std::size_t>(offset));
  if (!frame) return frame.status();
  return frame->rgb;
}

JoinedFrames::Place JoinedFrames::place_of(std::size_t index) const {
  if (index < first_->size()) return {*first_, index};
  return {*second_, index - first_->size()};
}

std::string JoinedFrames::name(std::size_t index) const {
  const Place place = place_of(index);
  return place.frames.name(place.index);
}

Result<PackFrame> JoinedFrames::read(std::size_t index) const {
  const Place place = place_of(index);
  return place.frames.read(place.index);
}

bool JoinedFrames::has_neighbours(std::size_t index) const {
  const Place place = place_of(index);
  return place.frames.has_neighbours(place.index);
}

Result<cv::Mat> JoinedFrames::neighbour(std::size_t index, int offset) const {
  const Place place = place_of(index);
  return place.frames.neighbour(place.index, offset);
}

std::string sequence_of(const std::string& name) {
  const std::size_t end = name.find('_');
  return end == std::string::npos ? "" : name.substr(0, end);
}

}  // namespace lcdm::model
